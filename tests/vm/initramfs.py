#!/usr/bin/env python3
"""initramfs.py KERNEL_ROOT OUT MODULE...: an initial RAM disk of busybox, `init` and the modules with all they depend on.

KERNEL_ROOT is an unpacked kernel package. The archive is a plain newc cpio, which kernels take as it is.
"""

import lzma
import os
import subprocess
import sys
from pathlib import Path



def zstd(data):
    """Python 3.14 is the first that can do this itself."""
    return subprocess.run(["zstd", "-dc"], input=data, stdout=subprocess.PIPE, check=True).stdout


COMPRESSED = {".xz": lzma.decompress, ".zst": zstd, "": bytes}


def named(path):
    """A module's name and how its file is compressed: `a/b-c.ko.xz` is `b_c`, `.xz`."""
    stem, _, compression = Path(path).name.partition(".ko")
    return stem.replace("-", "_"), compression


class Modules:
    """The modules of a kernel."""

    def __init__(self, root):
        folders = [f for top in ("lib", "usr/lib") for f in (root / top / "modules").glob("*") if f.is_dir()]
        if len(folders) != 1:
            sys.exit(f"initramfs.py: {root} holds modules of {len(folders)} kernels, not of one: remove it")
        self.files = {named(path)[0]: path for path in folders[0].rglob("*.ko*")}
        builtin = (folders[0] / "modules.builtin").read_text().split()
        self.builtin = {named(path)[0] for path in builtin}

    def closure(self, wanted):
        """Name and contents of what must be loaded, in this order."""
        loaded = {}

        def load(name):
            name = name.replace("-", "_")
            if name in loaded or name in self.builtin:
                return
            if name not in self.files:
                sys.exit(f"initramfs.py: this kernel has no module {name}: take Debian's, not one for clouds")
            path = self.files[name]
            data = COMPRESSED[named(path)[1]](path.read_bytes())
            begin = data.index(b"\0depends=") + len(b"\0depends=")
            for needed in data[begin : data.index(b"\0", begin)].decode().split(","):
                if needed:
                    load(needed)
            loaded[name] = data

        for name in wanted:
            load(name)
        return loaded


class Archive:
    """A newc cpio that grows."""

    def __init__(self, out):
        self.out, self.inode = out, 0

    def add(self, name, mode, data=b""):
        self.inode += 1
        path = name.encode() + b"\0"
        fields = (self.inode, mode, 0, 0, 1, 0, len(data), 0, 0, 0, 0, len(path), 0)
        head = b"070701" + b"".join(b"%08X" % field for field in fields) + path
        self.out.write(head + b"\0" * (-len(head) % 4) + data + b"\0" * (-len(data) % 4))


def main():
    root, out, wanted = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]
    modules = Modules(root).closure(wanted)
    here = Path(__file__).parent
    part = out.with_suffix(".part")
    with open(part, "wb") as file:
        archive = Archive(file)
        for folder in ("bin", "dev", "proc", "sys", "host", "modules"):
            archive.add(folder, 0o040755)
        archive.add("bin/busybox", 0o100755, Path("/bin/busybox").read_bytes())
        archive.add("bin/sh", 0o120777, b"busybox")
        archive.add("init", 0o100755, (here / "init").read_bytes())
        archive.add("modules/order", 0o100644, "".join(f"{name}\n" for name in modules).encode())
        for name, data in modules.items():
            archive.add(f"modules/{name}.ko", 0o100644, data)
        archive.add("TRAILER!!!", 0)
    os.replace(part, out)


main()
