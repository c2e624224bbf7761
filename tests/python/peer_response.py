"""Response curves beside OpenCV's: `peer_response.py cases.json`, written by tests/peers_response.rs.

Each case holds the images of one stack (rows of codes), exposures, a method, our 256 exposures and a tolerance on their
ratio to OpenCV's over the codes `judged`, both 1 at code 128.
"""
import json
import sys

import cv2
import numpy as np


def main():
    failed = False
    for case in json.load(open(sys.argv[1])):
        frames = [np.array(i, np.uint8).reshape(case["rows"], -1) for i in case["images"]]
        times = np.array(case["exposures_s"], np.float32)
        if case["method"] == "debevec":
            peer = cv2.createCalibrateDebevec(samples=case["samples"], lambda_=case["smoothness"])
        else:
            peer = cv2.createCalibrateRobertson(max_iter=1000, threshold=1e-6)
        curve = peer.process([cv2.merge([f, f, f]) for f in frames], times)[:, 0, 0].astype(float)
        low, high = case["judged"]
        theirs = curve[low:high + 1] / curve[128]
        ours = np.array(case["exposures"])[low:high + 1]
        worst = np.abs(ours / theirs - 1).max()
        print(f"{case['name']}: {worst:.4f} at most over codes {low} to {high}")
        failed |= not worst <= case["tolerance"]
    sys.exit(failed)


main()
