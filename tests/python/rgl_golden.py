"""Golden values of RGL .bsdf files, evaluated by Mitsuba 3 (variant scalar_rgb).

    python rgl_golden.py CORPUS/rgl > tests/golden/rgl_mitsuba.json

Needs mitsuba and numpy; made with Mitsuba 3.9.1. Each row is theta_i, phi_i, theta_o, phi_o (radians, i the light, o the
camera) and Mitsuba's value per channel: f cos(theta_i), negative values not clamped. Mitsuba calls the camera `wi` and
the light `wo`. The files called "synthetic-..." are made here and, bit for bit, by the Rust tests.
"""
import glob
import json
import os
import struct
import sys
import tempfile

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
ROWS = 40
PI = 3.1415927


def pattern(shape, step, low):
    """Multiples of 1/64, exact in f32, that look like nothing in particular."""
    k = np.arange(int(np.prod(shape)), dtype=np.int64)
    return (((k * step) % 64 + low) / 64).astype("<f4").reshape(shape)


def synthetic(phi, jacobian=1):
    p, t = len(phi), 3
    return {
        "description": np.frombuffer(b"synthetic", dtype="u1"),
        "jacobian": np.array([jacobian], dtype="u1"),
        "phi_i": np.array(phi, dtype="<f4"),
        "theta_i": np.array([0, 0.6, PI / 2], dtype="<f4"),
        "ndf": pattern((3, 5), 37, 8),
        # Step 16 makes both rows equal, as in isotropic files: Mitsuba 3.9 may turn the camera of those by half a turn
        # (its m_reduction is not initialised, mitsuba-renderer/mitsuba3#1850).
        "sigma": pattern((2, 4), 16 if p == 1 else 23, 16),
        "vndf": pattern((p, t, 7, 6), 41, 4),
        "luminance": pattern((p, t, 4, 4), 29, 4),
        "rgb": pattern((p, t, 3, 4, 4), 29, -8),
    }


SYNTHETIC = {
    "synthetic-isotropic": synthetic([0]),
    "synthetic-no-jacobian": synthetic([0], 0),
    "synthetic-full": synthetic([-PI, -1, 1, PI]),
    "synthetic-half-turn": synthetic([-PI, -2, 0]),
    "synthetic-both-axes": synthetic([-PI, -2, -PI / 2]),
}


def write_tensor_file(path, fields):
    offset = 18 + sum(13 + len(n) + 8 * a.ndim for n, a in fields.items())
    header, data = b"tensor_file\0" + bytes([1, 0]) + struct.pack("<I", len(fields)), b""
    for name, array in fields.items():
        dtype = 10 if array.dtype.itemsize == 4 else 1
        header += struct.pack("<H", len(name)) + name.encode()
        header += struct.pack("<HBQ", array.ndim, dtype, offset + len(data))
        header += struct.pack(f"<{array.ndim}Q", *array.shape)
        data += array.tobytes()
    assert len(header) == offset
    with open(path, "wb") as file:
        file.write(header + data)


def direction(theta, phi):
    return [float(x) for x in (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))]


def pairs(rng):
    """Every third light near the mirror direction of the camera, the others anywhere; no two angles equal."""
    for k in range(ROWS):
        theta_o, phi_o = rng.uniform(0.05, 1.45), rng.uniform(-np.pi, np.pi)
        theta_i, phi_i = rng.uniform(0.05, 1.45), rng.uniform(-np.pi, np.pi)
        if k % 3 == 0:
            theta_i, phi_i = np.clip(theta_o + rng.normal(0, 0.05), 0.02, 1.5), phi_o + np.pi + rng.normal(0, 0.05)
        yield [round(float(x), 4) for x in (theta_i, phi_i, theta_o, phi_o)]


def evaluate(path, rng):
    bsdf = mi.load_dict({"type": "measured", "filename": path})
    si = mi.SurfaceInteraction3f()
    rows = []
    for theta_i, phi_i, theta_o, phi_o in pairs(rng):
        si.wi = mi.Vector3f(direction(theta_o, phi_o))
        value = bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(direction(theta_i, phi_i)))
        rows.append([theta_i, phi_i, theta_o, phi_o] + [float(f"{float(v):.7g}") for v in value])
    return rows


def main():
    rng = np.random.default_rng(2018)
    result = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, fields in SYNTHETIC.items():
            path = os.path.join(folder, name + ".bsdf")
            write_tensor_file(path, fields)
            result[name] = evaluate(path, rng)
    for path in sorted(glob.glob(os.path.join(sys.argv[1], "*_rgb.bsdf"))):
        result[os.path.basename(path)] = evaluate(path, rng)
    rows = {name: ",\n".join(json.dumps(row) for row in rows) for name, rows in result.items()}
    print("{\n" + ",\n".join(f'"{name}": [\n{body}\n]' for name, body in rows.items()) + "\n}")


main()
