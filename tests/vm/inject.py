#!/usr/bin/env python3
"""inject.py FRAME WIDTH HEIGHT FOURCC: vivid's output plays FRAME, raw samples, into vivid's HDMI input at 30 Hz, again and again.

Runs until it is ended. A file that is moved to FRAME's place is shown from the next frame on. `/dev/video0` is then a camera
that delivers the frame to the last bit. Needs vivid with an output node, and v4l2-ctl.
"""

import os
import subprocess
import sys

CAMERA, OUTPUT = "/dev/video0", "/dev/video1"
HDMI_INPUT, HDMI_OUTPUT = 3, 1


def tell(device, *options):
    subprocess.run(["v4l2-ctl", "-d", device, *options], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def connect(width, height, fourcc):
    """Loops the output to the input, both with the same timings: nothing follows by itself."""
    timings = f"cvt,width={width},height={height},fps=30"
    picture = f"width={width},height={height},pixelformat={fourcc}"
    tell(OUTPUT, "-o", str(HDMI_OUTPUT), "--set-dv-bt-timings", timings)
    tell(OUTPUT, f"--set-fmt-video-out={picture}")
    tell(CAMERA, "-i", str(HDMI_INPUT), "-c", "osd_text_mode=2")
    controls = subprocess.run(["v4l2-ctl", "-d", CAMERA, "-l"], check=True, capture_output=True, text=True).stdout
    # Kernels before 6.12 know one loop for all inputs.
    loop = "hdmi_000_0_is_connected_to=2" if "hdmi_000_0_is_connected_to" in controls else "loop_video=1"
    tell(CAMERA, "-c", loop)
    tell(CAMERA, "--set-dv-bt-timings", timings)
    tell(CAMERA, f"--set-fmt-video={picture}")


def play(path):
    """Gives the driver the frame for ever; it takes one every 33 ms. Frames that follow must have the first one's size."""
    size = os.path.getsize(path)
    words = ["v4l2-ctl", "-d", OUTPUT, "--stream-out-mmap=3", "--stream-from=-"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    player = subprocess.Popen(words, stdin=subprocess.PIPE, **quiet)
    shown = frame = None
    while True:
        now = os.stat(path)
        if (now.st_ino, now.st_mtime_ns) != shown:
            with open(path, "rb") as file:
                frame = file.read()
            if len(frame) != size:
                sys.exit(f"inject.py: {path} has {len(frame)} bytes, a frame {size}")
            shown = (now.st_ino, now.st_mtime_ns)
        player.stdin.write(frame)


def main():
    path, width, height, fourcc = sys.argv[1:]
    connect(width, height, fourcc)
    print("connected", flush=True)
    play(path)


main()
