"""Whole functions of many directions against 50 digits: `peer_batch.py cases.json`, written by tests/peers_basis.rs."""
import json
import sys

import mpmath as mp

from exact import Zone


def main():
    cases = json.load(open(sys.argv[1]))
    failed = []
    for case in cases:
        zone = Zone(case["a"], case["b"])
        root2 = mp.sqrt(2)
        worst = (0.0, None)
        for vector, row in zip(case["vectors"], case["rows"]):
            x, y, z = map(mp.mpf, vector)
            r = mp.hypot(x, y)
            turn = mp.mpc(x, y) / r if r else mp.mpc(1)
            for m, column in enumerate(case["largest"]):
                azimuth = root2 * turn**m if m else mp.mpc(1)
                for l, most in enumerate(column, start=m):
                    polar = zone.polar(l, m, z)
                    most *= float(root2) if m else 1.0
                    for sign, factor in ((1, azimuth.real), (-1, azimuth.imag)) if m else ((1, azimuth.real),):
                        error = float(abs(row[l * (l + 1) + sign * m] - polar * factor)) / most
                        # A NaN compares false: count it as the worst.
                        if not error <= worst[0]:
                            worst = (error, (l, sign * m, vector))
        print(f"{case['name']}: worst error {worst[0]:.2e} of max |Z_lm| at l, m, direction = {worst[1]}")
        if not worst[0] <= case["tolerance"]:
            failed.append(f"{case['name']} above {case['tolerance']:.1e}")
    if failed:
        sys.exit("; ".join(failed))


main()
