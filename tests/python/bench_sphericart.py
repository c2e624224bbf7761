"""One timing of sphericart per line that comes in: `bench_sphericart.py cases.json`, written by tests/speed/mod.rs.

Called through its C interface, so that the output array exists and is touched before, as on the other side. A line of input
is an order; the answer is the nanoseconds per point. The first answer to an order waits until the values of both sides are
compared.
"""
import ctypes
import json
import os
import sys
import time

# One core, and pages of the size that the other side's arrays have.
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["NUMPY_MADVISE_HUGEPAGE"] = "0"

import numpy as np
import sphericart


def main():
    case = json.load(open(sys.argv[1]))
    xyz = np.array(case["directions"])
    library = ctypes.CDLL(os.path.join(os.path.dirname(sphericart.__file__), "lib", "libsphericart.so"))
    library.sphericart_spherical_harmonics_new.restype = ctypes.c_void_p
    library.sphericart_spherical_harmonics_new.argtypes = [ctypes.c_size_t]
    compute = library.sphericart_spherical_harmonics_compute_array
    compute.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p, ctypes.c_size_t]
    compute.restype = None
    prepared = {}
    for order in map(int, sys.stdin):
        if order not in prepared:
            # One array at a time, as on the other side.
            prepared.clear()
            sph = np.ones((len(xyz), (order + 1) ** 2))
            prepared[order] = library.sphericart_spherical_harmonics_new(order), sph
            compute(prepared[order][0], xyz.ctypes.data, xyz.size, sph.ctypes.data, sph.size)
            for i, ours in case["values"][str(order)]:
                worst = np.abs(sph[i] - ours).max() / np.abs(ours).max()
                if not worst <= case["tolerance"]:
                    sys.exit(f"order {order}, direction {i}: values differ by {worst:.1e}")
        calculator, sph = prepared[order]
        start = time.perf_counter()
        compute(calculator, xyz.ctypes.data, xyz.size, sph.ctypes.data, sph.size)
        print((time.perf_counter() - start) * 1e9 / len(xyz), flush=True)


main()
