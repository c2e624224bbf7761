"""One timing of OpenCV's MergeRobertson per line that comes in: `bench_merge.py cases.json`, written by tests/hdr_speed/mod.rs.

The scene is given as 8-bit frames in a raw file, one after the other, rows of three channels. A line of input is anything;
the answer is milliseconds of one merge on all cores.
"""
import json
import sys
import time

import cv2
import numpy as np


def main():
    case = json.load(open(sys.argv[1]))
    times = np.array(case["exposures_s"], np.float32)
    frames = np.fromfile(case["frames"], np.uint8).reshape(len(times), case["height"], case["width"], 3)
    frames = [np.ascontiguousarray(f) for f in frames]
    merge = cv2.createMergeRobertson()
    # The first call fills tables; what it gives must follow the light.
    got = merge.process(frames, times)
    if not got.mean() > 0:
        sys.exit("MergeRobertson gives no light")
    for _ in sys.stdin:
        start = time.perf_counter()
        merge.process(frames, times)
        print((time.perf_counter() - start) * 1e3, flush=True)


main()
