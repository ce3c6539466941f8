// What loading gives: a value, or one fault that says where, what and what to do. Nothing at load time throws across
// a function that returns a Result; the tick uses error bits instead (core/layout.hpp).
#pragma once
#include <string>
#include <utility>
#include <variant>

namespace hapticlod {

struct Fault {
    std::string where;   // file, line, section or field, as narrow as it is known
    std::string what;    // what is wrong there
    std::string remedy;  // what the user can do about it

    // The one line a user sees. Line breaks (a file name may hold one) become spaces.
    [[nodiscard]] std::string line() const;
};

template <class T>
class [[nodiscard]] Result {
public:
    Result(T value) : content_(std::move(value)) {}
    Result(Fault fault) : content_(std::move(fault)) {}

    [[nodiscard]] bool ok() const { return std::holds_alternative<T>(content_); }
    explicit operator bool() const { return ok(); }

    // Only when ok().
    [[nodiscard]] T& value() & { return std::get<T>(content_); }
    [[nodiscard]] const T& value() const& { return std::get<T>(content_); }
    [[nodiscard]] T&& value() && { return std::get<T>(std::move(content_)); }
    // Only when not ok().
    [[nodiscard]] const Fault& fault() const { return std::get<Fault>(content_); }

private:
    std::variant<T, Fault> content_;
};

}  // namespace hapticlod
