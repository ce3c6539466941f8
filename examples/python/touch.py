"""The C example in Python by ctypes: python touch.py libhapticlod.so BUNDLE TRUSTED_KEYS."""

import ctypes as c
import math
import sys

Vector, Turn = c.c_double * 3, c.c_double * 4


class Info(c.Structure):
    """hlod_info."""

    _fields_ = [
        ("struct_bytes", c.c_size_t), ("level_count", c.c_uint32), ("ball_count", c.c_uint32), ("loop_hz", c.c_double),
        ("budget_us", c.c_double), ("stiffness_n_mm", c.c_double), ("max_force_n", c.c_double), ("origin_mm", Vector),
        ("triangles", c.c_uint64 * 8), ("speeds_mm_s", c.c_double * 8), ("golden_ticks", c.c_uint64),
    ]  # fmt: skip


class Record(c.Structure):
    """hlod_record."""

    _fields_ = [
        ("time_s", c.c_double), ("hip_mm", Vector), ("scp_mm", Vector), ("force_n", Vector), ("torque_n_mm", Vector),
        ("speed_mm_s", c.c_float), ("cost_ns", c.c_float), ("level", c.c_uint8), ("contact", c.c_uint8),
        ("mapping", c.c_uint8), ("constraints", c.c_uint8), ("errors", c.c_uint32), ("counters", c.c_uint32 * 6),
    ]  # fmt: skip


def main(library: str, path: str, trusted_keys: str) -> None:
    """Move the tool as the golden motion does and print the largest force."""
    hlod = c.CDLL(library)
    message = c.create_string_buffer(256)

    def check(status: int) -> None:
        if status:
            sys.exit(message.value.decode())

    bundle, renderer = c.c_void_p(), c.c_void_p()
    check(hlod.hlod_bundle_open(path.encode(), c.byref(bundle), message, c.c_size_t(256)))
    check(hlod.hlod_bundle_trusted(bundle, trusted_keys.encode(), message, c.c_size_t(256)))
    info = Info(c.sizeof(Info))
    check(hlod.hlod_bundle_info(bundle, c.byref(info)))
    check(hlod.hlod_renderer_create(bundle, None, c.byref(renderer), message, c.c_size_t(256)))
    most_n, record = 0.0, Record()
    time_s, hip_mm, turned_wxyz = c.c_double(), Vector(), Turn()
    for tick in range(info.golden_ticks):
        hlod.hlod_bundle_golden(bundle, c.c_uint64(tick), c.byref(time_s), hip_mm, turned_wxyz, None)
        hlod.hlod_tick(renderer, time_s, hip_mm, turned_wxyz, c.byref(record))
        most_n = max(most_n, math.hypot(*record.force_n))
    print(f"{most_n:.6f}")
    hlod.hlod_renderer_destroy(renderer)
    hlod.hlod_bundle_close(bundle)


if __name__ == "__main__":
    main(*sys.argv[1:])
