"""Zonal functions against exact polynomials at 50 digits: `peer_zonal.py cases.json`, written by tests/peers_basis.rs."""
import json
import sys

import mpmath as mp

from exact import Zone


def main():
    cases = json.load(open(sys.argv[1]))
    failed = []
    for case in cases:
        zone = Zone(case["a"], case["b"])
        worst = (0.0, None)
        for mu, parts in zip(case["mu"], case["parts"]):
            for m, column in enumerate(parts):
                for l, got in enumerate(column, start=m):
                    error = float(abs(got - zone.polar(l, m, mp.mpf(mu))) / case["largest"][m][l - m])
                    # A NaN compares false: count it as the worst.
                    if not error <= worst[0]:
                        worst = (error, (l, m, mu))
        print(f"{case['name']}: worst error {worst[0]:.2e} of max |Z_lm| at l, m, mu = {worst[1]}")
        if not worst[0] <= case["tolerance"]:
            failed.append(f"{case['name']} above {case['tolerance']:.1e}")
    if failed:
        sys.exit("; ".join(failed))


main()
