"""Golden values of neural fits of MERL materials, evaluated with NumPy from the published formula.

    python nbrdf_golden.py CORPUS/merl/nbrdf_merl_f32le.bin > tests/golden/nbrdf_numpy.json

Each row is theta_i, phi_i, theta_o, phi_o (radians, i the light, o the camera) and f per channel, 1/sr.
"""
import json
import sys

import numpy as np


def nbrdf(w, wi, wo):
    w1, b1, w2, b2 = w[:126].reshape(6, 21), w[126:147], w[147:588].reshape(21, 21), w[588:609]
    w3, b3 = w[609:672].reshape(21, 3), w[672:]
    h = (wi + wo) / np.linalg.norm(wi + wo)
    ph, th = np.arctan2(h[1], h[0]), np.arccos(np.clip(h[2], -1, 1))
    c, s = np.cos(-ph), np.sin(-ph)
    v = np.array([c * wi[0] - s * wi[1], s * wi[0] + c * wi[1], wi[2]])
    c, s = np.cos(-th), np.sin(-th)
    d = np.array([c * v[0] + s * v[2], v[1], -s * v[0] + c * v[2]])
    a = np.maximum(np.array([np.sin(th), 0, np.cos(th), *d]) @ w1 + b1, 0)
    a = np.maximum(a @ w2 + b2, 0)
    return np.maximum(np.exp(a @ w3 + b3) - 1, 0)


def direction(theta, phi):
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def main():
    weights = np.fromfile(sys.argv[1], dtype="<f4").reshape(-1, 675).astype(float)
    rng = np.random.default_rng(2021)
    result = {}
    for row in (0, 24, 57, 99):
        angles = np.round(rng.uniform([0.02, -3, 0.02, -3], [1.5, 3, 1.5, 3], (20, 4)), 4)
        values = [nbrdf(weights[row], direction(*a[:2]), direction(*a[2:])) for a in angles]
        result[row] = [[*a.tolist(), *(float(f"{x:.12g}") for x in v)] for a, v in zip(angles, values)]
    body = ",\n".join(f'"{row}": [\n' + ",\n".join(json.dumps(r) for r in rows) + "\n]" for row, rows in result.items())
    print("{\n" + body + "\n}")


main()
