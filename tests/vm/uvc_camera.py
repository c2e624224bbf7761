#!/usr/bin/env python3
"""A USB Video Class camera without hardware, for the kernel's own uvcvideo, by USB/IP.

    uvc_camera.py                 in the guest: plugs itself in; what it sees is a ramp that exposure and gain scale
    uvc_camera.py plug HOST PORT  in the guest: plugs in a camera that another machine simulates (see host.py)

Formats Y12, Y16 and GREY of a linear 12-bit sensor; controls `exposure_time_absolute` (0.1 ms) and `gain` (16 is 1).
A frame's first packet is sent when its exposure ends, so that the driver's timestamps tell it.
"""

import array
import collections
import socket
import struct
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

SIZES = [(1360, 1024), (680, 512), (640, 480)]
# Four characters, and bits of a sample.
FORMATS = [(b"Y12 ", 16), (b"Y16 ", 16), (b"Y8  ", 8)]
GUID_TAIL = bytes.fromhex("00001000800000aa00389b71")
INTERVALS = [333_333, 666_666, 2_000_000]  # of 100 ns
UNITY_GAIN = 16
EXPOSURE_UNIT_S = 1e-4
WHITE = 4095
CAMERA_TERMINAL, PROCESSING_UNIT, OUTPUT_TERMINAL = 1, 2, 3
VIDEO_IN = 0x81  # endpoint
VHCI = "/sys/devices/platform/vhci_hcd.0/attach"
HIGH_SPEED, DEVICE_ID = 3, 1 << 16 | 2


def described(kind, body):
    """A descriptor: its length, its type, its body."""
    return bytes([2 + len(body), kind]) + body


def frame_bytes(format_index, frame_index):
    width, height = SIZES[frame_index - 1]
    return width * height * FORMATS[format_index - 1][1] // 8


def device_descriptor():
    return described(1, struct.pack("<HBBBBHHHBBBB", 0x0200, 0xEF, 2, 1, 64, 0x1209, 0x0001, 0x0100, 1, 2, 3, 1))


def control_interface():
    auto_mode_and_exposure, gain = 0x0A, 0x0200
    camera = described(0x24, struct.pack("<BBHBBHHHB3s", 2, CAMERA_TERMINAL, 0x0201, 0, 0, 0, 0, 0, 3, bytes([auto_mode_and_exposure, 0, 0])))
    unit = described(0x24, struct.pack("<BBBHBHB", 5, PROCESSING_UNIT, CAMERA_TERMINAL, 0, 2, gain, 0))
    output = described(0x24, struct.pack("<BBHBBB", 3, OUTPUT_TERMINAL, 0x0101, 0, PROCESSING_UNIT, 0))
    parts = camera + unit + output
    header = described(0x24, struct.pack("<BHHIBB", 1, 0x0100, 13 + len(parts), 48_000_000, 1, 1))
    return described(4, bytes([0, 0, 0, 0x0E, 1, 0, 0])) + header + parts


def streaming_interface():
    formats = b""
    for number, (fourcc, bits) in enumerate(FORMATS, 1):
        formats += described(0x24, struct.pack("<BBB4s12sBBBBBB", 4, number, len(SIZES), fourcc, GUID_TAIL, bits, 1, 0, 0, 0, 0))
        for frame, (width, height) in enumerate(SIZES, 1):
            size = frame_bytes(number, frame)
            rates = [size * 8 * 5, size * 8 * 30]
            fields = (5, frame, 0, width, height, *rates, size, INTERVALS[0], len(INTERVALS))
            intervals = struct.pack(f"<{len(INTERVALS)}I", *INTERVALS)
            formats += described(0x24, struct.pack("<BBBHHIIIIB", *fields) + intervals)
        formats += described(0x24, bytes([0x0D, 1, 1, 4]))
    length = 13 + len(FORMATS)
    header = struct.pack("<BBHBBBBBBB", 1, len(FORMATS), length + len(formats), VIDEO_IN, 0, OUTPUT_TERMINAL, 0, 0, 0, 1)
    endpoint = described(5, struct.pack("<BBHB", VIDEO_IN, 2, 512, 0))
    return described(4, bytes([1, 0, 1, 0x0E, 2, 0, 0])) + described(0x24, header + bytes(len(FORMATS))) + formats + endpoint


def configuration_descriptor():
    association = described(0x0B, bytes([0, 2, 0x0E, 3, 0, 0]))
    parts = association + control_interface() + streaming_interface()
    return described(2, struct.pack("<HBBBBB", 9 + len(parts), 2, 1, 0, 0x80, 250)) + parts


def string_descriptor(index):
    text = {1: "zonal", 2: "simulated camera", 3: "1"}.get(index)
    return described(3, b"\x09\x04" if index == 0 else (text or "").encode("utf-16-le"))


class Control:
    """A number the host may set."""

    def __init__(self, size, least, most, step, default, resolution=None):
        self.size, self.value = size, default
        self.answers = {0x82: least, 0x83: most, 0x84: step if resolution is None else resolution, 0x87: default}

    def request(self, request, data):
        if request == 0x01:
            self.value = int.from_bytes(data[: self.size], "little")
            return b""
        if request == 0x85:
            return struct.pack("<H", self.size)
        if request == 0x86:
            return b"\x03"
        answer = self.value if request == 0x81 else self.answers.get(request)
        return None if answer is None else answer.to_bytes(self.size, "little")


class UvcCamera:
    """The camera at one end of a socket that speaks USB/IP; `scene(exposure_s, gain, fourcc, width, height)` gives a frame's
    bytes as of the moment it is called."""

    def __init__(self, scene):
        self.scene = scene
        auto = Control(1, 1, 8, 1, 1, resolution=0b1001)  # manual, or aperture priority
        self.exposure = Control(4, 1, 100_000, 1, 100)
        self.gain = Control(2, 1, 255, 1, UNITY_GAIN)
        self.units = {CAMERA_TERMINAL: {2: auto, 4: self.exposure}, PROCESSING_UNIT: {4: self.gain}}
        self.probe = self.commit = (1, 1, INTERVALS[0])
        self.asked = collections.OrderedDict()  # what the driver waits for: number, size
        self.submitted = 0  # number of the last submission
        self.early = {}  # submissions that were taken back before they came, and by which number
        self.changed = threading.Condition()  # guards what is asked for, and the socket's writing side
        self.stream = 0  # how often streaming began or ended
        self.gone = False

    def serve(self, link):
        """Answers until the socket closes."""
        self.link = link
        threading.Thread(target=self.frames, daemon=True).start()
        try:
            while True:
                self.answer(self.read(48))
        except (ConnectionError, OSError):
            with self.changed:
                self.gone = True
                self.changed.notify_all()

    def read(self, size):
        data = bytearray()
        while len(data) < size:
            part = self.link.recv(size - len(data))
            if not part:
                raise ConnectionError
            data += part
        return bytes(data)

    def answer(self, head):
        command, number, _, reading, endpoint = struct.unpack(">5I", head[:20])
        if command == 2:
            submission = struct.unpack(">I", head[20:24])[0]
            # The kernel may overtake itself, and drops the connection if what it was told to be taken back is answered later.
            if submission > self.submitted:
                self.early[submission] = number
            else:
                self.take_back(submission, number)
            return
        size = struct.unpack(">i", head[24:28])[0]
        if endpoint != 0:
            with self.changed:
                self.asked[number] = size
                self.changed.notify_all()
        else:
            data = self.read(size) if reading == 0 and size > 0 else b""
            reply = self.control(head[40:48], data)
            with self.changed:
                if reply is None:
                    self.reply(number, -32, b"", 0)
                else:
                    self.reply(number, 0, reply[:size] if reading else b"", len(reply[:size]) if reading else size)
        self.submitted = number
        if number in self.early:
            self.take_back(number, self.early.pop(number))

    def take_back(self, submission, number):
        with self.changed:
            found = self.asked.pop(submission, None)
            self.link.sendall(struct.pack(">5Ii24x", 4, number, 0, 0, 0, 0 if found is None else -104))

    def reply(self, number, status, data, length):
        self.link.sendall(struct.pack(">5Iiiiii8x", 3, number, 0, 0, 0, status, length, 0, 0, 0) + data)

    def control(self, setup, data):
        """The answer to a control request; None refuses it."""
        kind, request, value, index, _ = struct.unpack("<BBHHH", setup)
        if kind == 0x80:
            if request == 6:
                parts = {1: device_descriptor, 2: configuration_descriptor, 3: lambda: string_descriptor(value & 255)}
                return parts[value >> 8]() if value >> 8 in parts else None
            return {0: b"\0\0", 8: b"\1"}.get(request)
        if kind in (0x81, 0x82):
            return b"\0\0"
        if kind == 2 and request == 1:
            self.restart()
            return b""
        if kind in (0, 1, 2):
            return b""
        if index & 255 == 1:
            return self.negotiate(request, value >> 8, data)
        control = self.units.get(index >> 8, {}).get(value >> 8)
        return control and control.request(request, data)

    def negotiate(self, request, selector, data):
        if request == 0x01:
            _, number, frame, interval = struct.unpack("<HBBI", data[:8])
            number, frame = max(1, min(number, len(FORMATS))), max(1, min(frame, len(SIZES)))
            chosen = (number, frame, min(INTERVALS, key=lambda i: abs(i - interval)))
            if selector == 1:
                self.probe = chosen
            else:
                self.commit = chosen
                self.restart()
            return b""
        if request == 0x85:
            return struct.pack("<H", 26)
        if request == 0x86:
            return b"\x03"
        number, frame, interval = self.probe if selector == 1 else self.commit
        size = frame_bytes(number, frame)
        return struct.pack("<HBBIHHHHHII", 0, number, frame, interval, 0, 0, 0, 0, 0, size, size + 2)

    def restart(self):
        with self.changed:
            self.stream += 1
            self.changed.notify_all()

    def frames(self):
        """Frame after frame, as long as somebody waits for them."""
        toggle = 0
        with ThreadPoolExecutor(1) as pool:
            while True:
                with self.changed:
                    self.changed.wait_for(lambda: self.asked or self.gone)
                    if self.gone:
                        return
                    stream = self.stream
                began = time.monotonic()
                number, frame, interval = self.commit
                exposure_s = self.exposure.value * EXPOSURE_UNIT_S
                gain = self.gain.value / UNITY_GAIN
                picture = pool.submit(self.scene, exposure_s, gain, FORMATS[number - 1][0], *SIZES[frame - 1])
                time.sleep(exposure_s)
                toggle ^= 1
                if self.send(bytes([2, 0x80 | toggle]), stream):
                    self.send(bytes([2, 0x82 | toggle]) + picture.result(), stream)
                time.sleep(max(0.0, began + interval / 1e7 - time.monotonic()))

    def send(self, payload, stream):
        """Sends a payload in the pieces that are asked for; whether it was wanted to the end."""
        at = 0
        while at < len(payload):
            with self.changed:
                self.changed.wait_for(lambda: self.asked or self.gone or self.stream != stream)
                if self.gone or self.stream != stream:
                    return False
                number, size = self.asked.popitem(last=False)
                piece = payload[at : at + size]
                at += size
                try:
                    self.reply(number, 0, piece, len(piece))
                except OSError:
                    return False
        return True


class Ramp:
    """Light that grows from column to column: sample = 2 column (exposure / 10 ms) gain, up to white."""

    def __init__(self):
        self.kept = (None, b"")

    def __call__(self, exposure_s, gain, fourcc, width, height):
        key = (exposure_s, gain, fourcc, width, height)
        if self.kept[0] != key:
            row = [min(WHITE, int(2 * column * exposure_s / 0.01 * gain + 0.5)) for column in range(width)]
            if fourcc == b"Y8  ":
                line = bytes(s >> 4 for s in row)
            else:
                line = array.array("H", [s << 4 for s in row] if fourcc == b"Y16 " else row).tobytes()
            self.kept = (key, line * height)
        return self.kept[1]


def plug(link):
    """Has the kernel take the other end of a connected socket for a USB device."""
    with open(VHCI, "w") as attach:
        attach.write(f"0 {link.fileno()} {DEVICE_ID} {HIGH_SPEED}")


def main():
    if sys.argv[1:2] == ["plug"]:
        link = socket.create_connection((sys.argv[2], int(sys.argv[3])))
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        plug(link)
    else:
        ours, theirs = socket.socketpair()
        plug(theirs)
        theirs.close()
        print("plugged in", flush=True)
        UvcCamera(Ramp()).serve(ours)


if __name__ == "__main__":
    main()
