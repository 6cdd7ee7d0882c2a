#include <chrono>
#include <cstdio>
#include <cstring>

#include "check.hpp"

namespace checks {

std::vector<Test>& tests() {
    static std::vector<Test> all;
    return all;
}

}  // namespace checks

// Runs all tests, or those whose names contain the first argument.
int main(int count, char** arguments) {
    int failed = 0, ran = 0;
    for (const auto& test : checks::tests()) {
        if (count > 1 && std::strstr(test.name.c_str(), arguments[1]) == nullptr) continue;
        ++ran;
        const auto begun = std::chrono::steady_clock::now();
        std::string problem;
        try {
            test.body();
        } catch (const std::exception& error) {
            problem = error.what();
            ++failed;
        }
        const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begun;
        std::printf("%s %s (%.2f s)%s%s\n", problem.empty() ? "ok  " : "FAIL", test.name.c_str(), took.count(),
                    problem.empty() ? "" : ": ", problem.c_str());
        std::fflush(stdout);
    }
    std::printf("%d tests, %d failed\n", ran, failed);
    return failed == 0 && ran > 0 ? 0 : 1;
}
