"""Designs data/multiplexed.toml: mixtures of zonal functions that are told apart by the azimuth at which the camera sees them.

A block of degrees lo..hi is shown as hi - lo + 1 mixtures q_j = Re sum_lm c_jlm N_lm(x') e^{-i m phi}, N_lm the zonal function
without its azimuth and for the zone of solid angle 1, max |q_j| = 1. Of an isotropic sample the ring of exitant directions shows
harmonic m of q_j as sum_l c_jlm z_lm, so that one small block for each m gives the coefficients. Minimised is the mean variance of
the coefficients for noise that does not depend on the light (a pair of frames of q_j has the same noise whatever q_j is), which
is a matter of how flat the mixtures are: sums of single functions waste the range of the projector.

    python multiplexed_design.py > ../../data/multiplexed.toml
"""

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln, lpmv

BLOCKS = [(0, hi) for hi in range(2, 11, 2)] + [(lo, lo + 1) for lo in range(3, 20, 2)]
TRIES = 40
SEED = 1


def function(l, m, x):
    """Zonal function over solid angle 1 without its azimuth."""
    k = np.sqrt((2 * l + 1) * np.exp(gammaln(l - m + 1) - gammaln(l + m + 1)))
    return k * lpmv(m, l, x) * (-1) ** m * (np.sqrt(2) if m else 1)


class Block:
    def __init__(self, lo, hi, fineness):
        self.degrees = [[l for l in range(max(lo, m), hi + 1)] for m in range(hi + 1)]
        self.mixtures = hi - lo + 1
        n = fineness * max(hi, 4)
        x = np.cos(np.linspace(0, np.pi, n + 1))
        phi = np.linspace(0, 2 * np.pi, n, endpoint=False)
        self.shapes = [np.stack([function(l, m, x) for l in ls]) for m, ls in enumerate(self.degrees)]
        self.waves = np.stack([np.exp(1j * m * phi) for m in range(hi + 1)])
        self.ends = np.cumsum([len(ls) for ls in self.degrees])

    def split(self, parameters):
        c = parameters.reshape(2, self.mixtures, -1)
        parts = np.split(c[0] + 1j * c[1], self.ends[:-1], axis=1)
        parts[0] = parts[0].real + 0j
        return parts

    def fields(self, parts):
        rows = np.stack([c @ s for c, s in zip(parts, self.shapes)], axis=2)  # mixture, x, m
        return np.real(rows @ np.conj(self.waves))

    def variance(self, parts, grow=None):
        """Sum of the coefficients' variances, and its derivatives."""
        total, slopes = 0.0, []
        for m, c in enumerate(parts):
            weight = 2.0 if m else 1.0  # a cosine over the ring has half the power of a constant
            inverse = np.linalg.inv(np.real(np.conj(c).T @ c) + 1e-9 * np.eye(c.shape[1]))
            total += weight * np.trace(inverse)
            slopes.append(-2 * weight * (c @ (inverse @ inverse)))
        return total, slopes

    def objective(self, parameters, power):
        parts = self.split(parameters)
        q = self.fields(parts)
        peak = np.abs(q).max(axis=(1, 2), keepdims=True)
        ratio = np.abs(q) / peak
        mean = (ratio**power).mean(axis=(1, 2), keepdims=True)
        top = (peak * mean ** (1 / power))[:, 0, 0]
        d_top = ratio ** (power - 1) * np.sign(q) / (peak * mean * q[0].size)
        total, slopes = self.variance([c / top[:, None] for c in parts])
        d_log_top = -sum(np.real(np.conj(c / top[:, None]) * g).sum(axis=1) for c, g in zip(parts, slopes))
        gradient = []
        for m, g in enumerate(slopes):
            along = d_top @ self.waves[m].real + 1j * (d_top @ self.waves[m].imag)
            d = g / top[:, None] + d_log_top[:, None] * (along @ self.shapes[m].T)
            gradient.append(d if m else d.real + 0j)
        gradient = np.concatenate(gradient, axis=1) / total
        return np.log(total), np.concatenate([gradient.real.ravel(), gradient.imag.ravel()])


def design(lo, hi):
    rng = np.random.default_rng(SEED)
    block, fine = Block(lo, hi, 8), Block(lo, hi, 40)
    best = None
    for _ in range(TRIES if hi < 7 else 6):
        parameters = rng.normal(size=2 * block.mixtures * block.ends[-1])
        for power in (6, 12, 30, 80, 200):
            parameters = minimize(block.objective, parameters, args=(power,), jac=True, method="L-BFGS-B", options={"maxiter": 200}).x
        parts = fine.split(parameters)
        top = np.abs(fine.fields(parts)).max(axis=(1, 2))
        parts = [c / top[:, None] for c in parts]
        total = fine.variance(parts)[0]
        if best is None or total < best[0]:
            best = total, parts
    total, parts = best
    # The first degree's axially symmetric part is positive: a sign that means nothing.
    signs = np.sign(parts[0][:, 0].real)
    return total / block.ends[-1], [c * signs[:, None] for c in parts]


def main():
    print("# Mixtures of zonal functions for isotropic samples; made by tests/python/multiplexed_design.py.")
    print("# cos[j][i] and sin[j][i]: what mixture j holds of cos(m phi) and sin(m phi) N_lm, i counting m = 0..=hi, then l = max(lo, m)..=hi.")
    print("version = 1")
    for lo, hi in BLOCKS:
        variance, parts = design(lo, hi)
        print(f"\n[[block]]\ndegrees = [{lo}, {hi}]\nvariance = {variance:.3f}")
        whole = np.concatenate(parts, axis=1)
        for name, values in (("cos", whole.real), ("sin", whole.imag)):
            rows = ",\n    ".join("[" + ", ".join(f"{v:.6f}" for v in row) + "]" for row in values)
            print(f"{name} = [\n    {rows},\n]")


if __name__ == "__main__":
    main()
