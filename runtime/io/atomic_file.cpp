#include "io/atomic_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>

namespace hapticlod {
namespace {

bool write_all(int descriptor, std::string_view content) {
    while (!content.empty()) {
        const ssize_t written = ::write(descriptor, content.data(), content.size());
        if (written < 0 && errno == EINTR) continue;
        if (written < 0) return false;
        content.remove_prefix(static_cast<std::size_t>(written));
    }
    return true;
}

// Mode of the file that is replaced, else what the umask gives.
mode_t mode_for(const std::string& path) {
    struct stat status {};
    if (::stat(path.c_str(), &status) == 0) return status.st_mode & 07777;
    const mode_t mask = ::umask(0);
    ::umask(mask);
    return 0666 & ~mask;
}

}  // namespace

std::optional<Fault> write_file_atomic(const std::string& path, std::string_view content) {
    // A symbolic link is followed, so that the link itself survives.
    std::string target = path;
    if (char* real = ::realpath(path.c_str(), nullptr); real != nullptr) {
        target = real;
        std::free(real);
    }
    const auto fault = [&path](int reason) {
        return Fault{path, std::string("cannot be written (") + std::strerror(reason) + ")",
                     "choose a folder that exists and is writable"};
    };
    struct stat status {};
    if (::stat(target.c_str(), &status) == 0 && S_ISDIR(status.st_mode)) return fault(EISDIR);
    std::string beside = target + ".XXXXXX";
    const int descriptor = ::mkstemp(beside.data());
    if (descriptor < 0) return fault(errno);
    bool good =
        write_all(descriptor, content) && ::fchmod(descriptor, mode_for(target)) == 0 && ::fsync(descriptor) == 0;
    int reason = errno;
    if (::close(descriptor) != 0 && good) {
        good = false;
        reason = errno;
    }
    if (good && ::rename(beside.c_str(), target.c_str()) != 0) {
        good = false;
        reason = errno;
    }
    if (!good) {
        ::unlink(beside.c_str());
        return fault(reason);
    }
    const std::size_t slash = target.rfind('/');
    const std::string folder = slash == std::string::npos ? "." : target.substr(0, slash + 1);
    if (const int parent = ::open(folder.c_str(), O_RDONLY | O_CLOEXEC); parent >= 0) {
        (void)::fsync(parent);  // the rename survives a power cut; some file systems cannot, which is no fault
        ::close(parent);
    }
    return std::nullopt;
}

}  // namespace hapticlod
