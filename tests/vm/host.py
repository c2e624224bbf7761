#!/usr/bin/env python3
"""host.py [options] -- COMMAND: runs a shell command in a virtual machine and exits with its status.

What the guest can ask of this side, through the exchange folder (/mnt there):
    NAME.wanted   a file moved to this name asks what the display shows; the answer is NAME, a PPM of it
Where --twin names a program, the guest can also plug in a camera (tests/vm/uvc_camera.py plug $ZONAL_VM_CAMERA) that looks
at the display through it: for each frame the program gets a line `EXPOSURE_S WIDTH HEIGHT` and the display's RGB pixels,
and answers with the sensor's samples, 16 bits each, little-endian.

Exits with 124 if the guest takes too long, with 125 if it ends without a status.
"""

import argparse
import json
import os
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from uvc_camera import UvcCamera

HERE = Path(__file__).resolve().parent
TIMED_OUT, NO_STATUS = 124, 125


def shared(name, folder, more):
    """QEMU's arguments for a folder that the guest mounts by this name."""
    backend = f"local,id={name},path={folder},security_model=none{more}"
    return ["-fsdev", backend, "-device", f"virtio-9p-pci,fsdev={name},mount_tag={name}"]


class Machine:
    """QEMU with the guest in it."""

    def __init__(self, options, exchange, scratch):
        width, height = options.display.split("x")
        self.monitor = scratch / "monitor"
        self.console = scratch / "console"
        arguments = [
            "qemu-system-x86_64", "-machine", "q35", "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2", "-m", "1536",
            "-nodefaults", "-display", "none", "-no-reboot",
            "-serial", f"file:{self.console}", "-qmp", f"unix:{self.monitor},server=on,wait=off",
            "-kernel", str(options.kernel), "-initrd", str(options.initrd),
            "-append", "console=ttyS0 quiet panic=-1 mitigations=off",
            "-device", f"virtio-gpu-pci,xres={width},yres={height}",
            "-netdev", "user,id=net", "-device", "virtio-net-pci,netdev=net,romfile=",
            *shared("root", "/", ",readonly=on,multidevs=remap"), *shared("exchange", exchange, ""),
        ]
        self.process = subprocess.Popen(arguments, stdin=subprocess.DEVNULL, start_new_session=True)
        self.lock = threading.Lock()
        self.link = None

    def ask(self, command, **arguments):
        """A command of QEMU's monitor."""
        with self.lock:
            if self.link is None:
                self.connect()
            return self.exchange({"execute": command, "arguments": arguments})

    def connect(self):
        connection = socket.socket(socket.AF_UNIX)
        for _ in range(100):
            try:
                connection.connect(str(self.monitor))
                break
            except OSError:
                time.sleep(0.05)
        self.link = connection.makefile("rw")
        self.link.readline()
        self.exchange({"execute": "qmp_capabilities"})

    def exchange(self, message):
        self.link.write(json.dumps(message) + "\n")
        self.link.flush()
        while True:
            answer = json.loads(self.link.readline() or '{"error": "the monitor is closed"}')
            if "error" in answer:
                raise RuntimeError(f"{message['execute']}: {answer['error']}")
            if "return" in answer:
                return answer["return"]

    def display(self, path):
        """Writes what the display shows, as PPM; the file is whole once it is there."""
        part = path.with_suffix(".part")
        self.ask("screendump", filename=str(part))
        os.replace(part, path)

    def end(self):
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


def pixels(ppm):
    """Width, height and RGB of a PPM."""
    kind, size, most, data = ppm.split(b"\n", 3)
    if (kind, most) != (b"P6", b"255"):
        raise RuntimeError("the screendump is no PPM of 8 bits")
    width, height = map(int, size.split())
    return width, height, data


class Twin:
    """The scene in front of a camera: what the display shows, through a program."""

    def __init__(self, machine, program, scratch):
        self.machine, self.picture = machine, scratch / "seen.ppm"
        self.process = subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def __call__(self, exposure_s, gain, fourcc, width, height):
        if (gain, fourcc) != (1.0, b"Y12 "):
            raise RuntimeError(f"the twin delivers Y12 at gain 1, not {fourcc} at {gain}")
        self.machine.display(self.picture)
        columns, rows, rgb = pixels(self.picture.read_bytes())
        self.process.stdin.write(f"{exposure_s:.6f} {columns} {rows}\n".encode() + rgb)
        self.process.stdin.flush()
        size = 2 * width * height
        samples = self.process.stdout.read(size)
        if len(samples) != size:
            raise RuntimeError("the twin ended")
        return samples

    def camera(self):
        """The port at which the camera can be plugged in."""
        listener = socket.create_server(("127.0.0.1", 0))

        def serve():
            while True:
                link, _ = listener.accept()
                link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=UvcCamera(self).serve, args=(link,), daemon=True).start()

        threading.Thread(target=serve, daemon=True).start()
        return listener.getsockname()[1]


def answer(machine, exchange):
    """Serves what the guest asks for."""
    for wanted in exchange.glob("*.wanted"):
        machine.display(exchange / wanted.stem)
        wanted.unlink()


def write_command(exchange, words, variables):
    """The script that the guest runs."""
    inside = {"PATH": os.environ["PATH"], "HOME": "/run", "TMPDIR": "/run/tmp", "ZONAL_VM": "/mnt", "RUST_BACKTRACE": "1", **variables}
    inside |= {name: value for name, value in os.environ.items() if name.startswith("ZONAL_VM_")}
    exports = "".join(f"export {name}={shlex.quote(value)}\n" for name, value in inside.items())
    (exchange / "command").write_text(f"{exports}cd {shlex.quote(os.getcwd())}\n{' '.join(words)}\n")


def outcome(machine, exchange, deadline):
    """Waits for the guest to end; its status."""
    while machine.process.poll() is None:
        if time.monotonic() > deadline:
            return TIMED_OUT
        answer(machine, exchange)
        time.sleep(0.02)
    status = exchange / "status"
    return int(status.read_text()) if status.exists() else NO_STATUS


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--kernel", type=Path, required=True)
    parser.add_argument("--initrd", type=Path, required=True)
    parser.add_argument("--display", default="800x600", help="size of the guest's display")
    parser.add_argument("--timeout", type=float, default=600.0, help="seconds after which the guest is ended")
    parser.add_argument("--twin", type=shlex.split, help="the program that turns displayed pixels into camera frames")
    parser.add_argument("command", nargs="+")
    options = parser.parse_args()
    deadline = time.monotonic() + options.timeout
    with tempfile.TemporaryDirectory(prefix="zonal-vm-") as scratch:
        scratch = Path(scratch)
        exchange = scratch / "exchange"
        exchange.mkdir()
        machine = Machine(options, exchange, scratch)
        try:
            variables = {}
            if options.twin:
                variables["ZONAL_VM_CAMERA"] = f"10.0.2.2 {Twin(machine, options.twin, scratch).camera()}"
            write_command(exchange, options.command, variables)
            status = outcome(machine, exchange, deadline)
        finally:
            machine.end()
        output = exchange / "output"
        sys.stdout.write(output.read_text(errors="replace") if output.exists() else "")
        if status in (TIMED_OUT, NO_STATUS):
            why = f"took more than {options.timeout:.0f} s" if status == TIMED_OUT else "ended without a status"
            print(f"host.py: the guest {why}; its console:", file=sys.stderr)
            print(machine.console.read_text(errors="replace"), file=sys.stderr)
    sys.exit(status)


main()
