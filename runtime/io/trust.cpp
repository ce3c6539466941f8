#include "io/trust.hpp"

#include <sys/stat.h>
#include <unistd.h>

#include <charconv>
#include <cstdlib>

#include "io/mapped_file.hpp"

namespace hapticlod {
namespace {

constexpr const char* kLineRemedy = "write: ed25519 KEY name [until=YYYY-MM-DD]; `hapticlod key trust` does";
constexpr std::size_t kMaxBytes = 1 << 20;

// Takes the next word off the front; empty at the end of the line.
std::string_view next_word(std::string_view& line) {
    const std::size_t first = line.find_first_not_of(" \t\r");
    if (first == std::string_view::npos) return line = {};
    line.remove_prefix(first);
    const std::string_view word = line.substr(0, line.find_first_of(" \t\r"));
    line.remove_prefix(word.size());
    return word;
}

bool parse_digits(std::string_view text, int& value) {
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    return error == std::errc() && end == text.data() + text.size() && value >= 0;
}

std::optional<std::chrono::sys_days> parse_day(std::string_view text) {
    int year = 0, month = 0, day = 0;
    if (text.size() != 10 || text[4] != '-' || text[7] != '-' || !parse_digits(text.substr(0, 4), year) ||
        !parse_digits(text.substr(5, 2), month) || !parse_digits(text.substr(8, 2), day)) {
        return std::nullopt;
    }
    const std::chrono::year_month_day date{std::chrono::year(year), std::chrono::month(static_cast<unsigned>(month)),
                                           std::chrono::day(static_cast<unsigned>(day))};
    if (!date.ok()) return std::nullopt;
    return std::chrono::sys_days(date);
}

}  // namespace

Result<std::vector<TrustedKey>> parse_trusted_keys(std::string_view text, const std::string& name) {
    std::vector<TrustedKey> keys;
    for (std::size_t number = 1; !text.empty(); ++number) {
        const std::size_t stop = text.find('\n');
        std::string_view line = text.substr(0, stop);
        text = stop == std::string_view::npos ? std::string_view{} : text.substr(stop + 1);
        const std::string where = name + ":" + std::to_string(number);
        const std::string_view kind = next_word(line);
        if (kind.empty() || kind.front() == '#') continue;
        if (kind == "ed25519-secret") return Fault{where, "is a secret key", "keep it away from here; name the .pub"};
        if (kind != "ed25519") return Fault{where, "is no line of a trusted key", kLineRemedy};
        const std::optional<PublicKey> key = public_key_from_base64(next_word(line));
        if (!key) return Fault{where, "has no key of 32 bytes in base64", kLineRemedy};
        TrustedKey entry{*key, std::string(next_word(line)), std::nullopt};
        if (entry.name.empty() || entry.name.starts_with("until=")) return Fault{where, "has no name", kLineRemedy};
        if (const std::string_view until = next_word(line); !until.empty()) {
            if (until.starts_with("until=")) entry.until = parse_day(until.substr(6));
            if (!entry.until) return Fault{where, "has something else than until=YYYY-MM-DD", kLineRemedy};
        }
        if (!next_word(line).empty()) return Fault{where, "has words too many", kLineRemedy};
        keys.push_back(std::move(entry));
    }
    return keys;
}

Result<std::vector<TrustedKey>> read_trusted_keys(const std::string& path) {
    struct stat status {};
    if (::stat(path.c_str(), &status) == 0 && S_ISREG(status.st_mode)) {
        if ((status.st_mode & (S_IWGRP | S_IWOTH)) != 0) {
            return Fault{path, "can be written by others, who could add keys", "chmod go-w it"};
        }
        if (status.st_size == 0) return std::vector<TrustedKey>{};
    }
    const Result<MappedFile> file = MappedFile::open(path);
    if (!file) return file.fault();
    const auto bytes = file.value().bytes();
    if (bytes.size() > kMaxBytes) return Fault{path, "is larger than 1 MiB", "name a file of trusted keys"};
    return parse_trusted_keys({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, path);
}

std::vector<std::string> standard_trust_files() {
    const auto set = [](const char* name) {
        const char* value = std::getenv(name);
        return std::string(value == nullptr ? "" : value);
    };
    std::vector<std::string> files = {"/etc/hapticlod/trusted_keys"};
    if (const std::string own = set("HAPTICLOD_CONFIG"); !own.empty()) {
        files.push_back(own + "/trusted_keys");
    } else if (const std::string config = set("XDG_CONFIG_HOME"); !config.empty()) {
        files.push_back(config + "/hapticlod/trusted_keys");
    } else if (const std::string home = set("HOME"); !home.empty()) {
        files.push_back(home + "/.config/hapticlod/trusted_keys");
    }
    std::erase_if(files, [](const std::string& file) { return ::access(file.c_str(), F_OK) != 0; });
    return files;
}

std::string TrustVerdict::text() const {
    switch (trust) {
        case Trust::trusted:
            return "signed by " + signer + ", trusted";
        case Trust::unknown_key:
            return "signed by a key that is not trusted here (" + signer + ")";
        case Trust::expired:
            return "signed by " + signer + ", whose trust has expired";
        case Trust::unsigned_bundle:
            break;
    }
    return "not signed";
}

TrustVerdict judge_trust(const std::optional<PublicKey>& signer, const std::vector<TrustedKey>& keys,
                         std::chrono::sys_days today) {
    if (!signer) return {};
    TrustVerdict verdict{Trust::unknown_key, base64(*signer)};
    for (const TrustedKey& entry : keys) {
        if (entry.key != *signer) continue;
        if (!entry.until || today <= *entry.until) return {Trust::trusted, entry.name};
        verdict = {Trust::expired, entry.name};
    }
    return verdict;
}

Result<TrustVerdict> trust_of(const std::optional<PublicKey>& signer,
                              const std::optional<std::string>& trusted_keys_path) {
    std::vector<TrustedKey> keys;
    const auto files = trusted_keys_path ? std::vector<std::string>{*trusted_keys_path} : standard_trust_files();
    for (const std::string& file : files) {
        auto read = read_trusted_keys(file);
        if (!read) return read.fault();
        for (TrustedKey& key : read.value()) keys.push_back(std::move(key));
    }
    return judge_trust(signer, keys, std::chrono::floor<std::chrono::days>(std::chrono::system_clock::now()));
}

}  // namespace hapticlod
