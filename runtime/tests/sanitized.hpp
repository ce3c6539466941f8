// HAPTICLOD_SANITIZED: compiled under AddressSanitizer or ThreadSanitizer, by gcc or clang.
#pragma once

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define HAPTICLOD_SANITIZED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define HAPTICLOD_SANITIZED 1
#endif
#endif
