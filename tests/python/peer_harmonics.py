"""Real spherical harmonics against SciPy: `peer_harmonics.py cases.json`, written by tests/peers_basis.rs."""
import json
import sys

import numpy as np
from scipy.special import sph_harm_y


def main():
    cases = json.load(open(sys.argv[1]))
    rows = np.array(cases["values"])
    theta = np.arccos(np.array(cases["mu"]))
    phi = np.array(cases["phi"])
    worst = (0.0, None)
    for l in range(cases["order"] + 1):
        for m in range(-l, l + 1):
            # SciPy's functions are complex and carry the Condon-Shortley phase (-1)^m.
            y = (-1) ** abs(m) * sph_harm_y(l, abs(m), theta, phi)
            want = y.real if m == 0 else np.sqrt(2) * (y.real if m > 0 else y.imag)
            errors = np.abs(rows[:, l * (l + 1) + m] - want)
            i = int(errors.argmax())
            worst = max(worst, (float(errors[i]), (l, m, cases["mu"][i], cases["phi"][i])), key=lambda w: w[0])
    print(f"worst error {worst[0]:.2e} at l, m, mu, phi = {worst[1]}")
    if not (np.isfinite(rows).all() and worst[0] <= cases["tolerance"]):
        sys.exit(f"above {cases['tolerance']:.1e}")


main()
