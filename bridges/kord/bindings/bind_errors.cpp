#include "bindings.hpp"
#include "types.hpp"

namespace nb = nanobind;

namespace station_kord {

void bind_errors(nb::module_&) {
    nb::register_exception_translator([](const std::exception_ptr& thrown, void*) {
        try {
            std::rethrow_exception(thrown);
        } catch (const Refusal& refusal) {
            const nb::object kind = nb::module_::import_("station_kord.errors").attr(refusal.kind);
            PyErr_SetString(kind.ptr(), refusal.what());
        }
    });
}

}  // namespace station_kord
