// Tests without a framework: each registers itself, a check that fails says where and ends its test.
#pragma once

#include <cmath>
#include <functional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace checks {

struct Test {
    std::string name;
    std::function<void()> body;
};

std::vector<Test>& tests();

struct Registered {
    Registered(const char* name, std::function<void()> body) { tests().push_back({name, std::move(body)}); }
};

inline void fail(const char* file, int line, const std::string& what) {
    std::ostringstream text;
    text << file << ":" << line << ": " << what;
    throw std::runtime_error(text.str());
}

inline void near(const char* file, int line, const char* what, double value, double wanted, double margin) {
    if (!(std::abs(value - wanted) <= margin))
        fail(file, line, std::string(what) + " is " + std::to_string(value) + ", not " + std::to_string(wanted));
}

}  // namespace checks

#define TEST(name)                                              \
    static void name();                                         \
    static const checks::Registered registered_##name(#name, name); \
    static void name()

#define CHECK(condition) \
    if (!(condition)) checks::fail(__FILE__, __LINE__, "does not hold: " #condition)

#define CHECK_NEAR(value, wanted, margin) \
    checks::near(__FILE__, __LINE__, #value, static_cast<double>(value), static_cast<double>(wanted), margin)
