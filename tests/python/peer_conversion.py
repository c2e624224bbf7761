"""The change from zonal functions to SH against 50 digits: `peer_conversion.py cases.json`, from tests/peers_basis.rs.

Per block: G and B (integrals of products) and C = (G + lambda D^2)^-1 B with D = l (l + 1) - 2, each relative to its own
largest entry.
"""
import json
import sys

import mpmath as mp

from exact import Zone, gram, largest, mixed


def error(got, want):
    return float(largest(mp.matrix(got) - want) / largest(want))


def main():
    cases = json.load(open(sys.argv[1]))
    failed = []
    for case in cases:
        zone = Zone(case["a"], case["b"])
        worst = {"gram": 0.0, "mixed": 0.0, "matrix": 0.0}
        for block in case["blocks"]:
            m, degrees = block["m"], block["degrees"]
            columns = list(range(m, case["order"] + 1))
            want = {"gram": gram(zone, m, degrees), "mixed": mixed(zone, m, degrees, columns)}
            if m % 2 == 1:
                again = mixed(zone, m, degrees, columns, nodes=260)
                if error(again, want["mixed"]) > 1e-25:
                    sys.exit(f"{case['name']}: the peer's own integrals have not converged")
            held = mp.diag([mp.mpf(case["lambda"]) * (l * (l + 1) - 2) ** 2 for l in degrees])
            want["matrix"] = mp.inverse(want["gram"] + held) * want["mixed"]
            for key in worst:
                e = error(block[key], want[key])
                if not e <= worst[key]:
                    worst[key] = e
        line = ", ".join(f"{key} {e:.1e} of {case['tolerance'][key]:.1e}" for key, e in worst.items())
        print(f"{case['name']}: {line} (condition {case['condition']:.1e})")
        if any(not e <= case["tolerance"][key] for key, e in worst.items()):
            failed.append(case["name"])
    if failed:
        sys.exit("above tolerance: " + ", ".join(failed))


main()
