#!/usr/bin/env bash
# Tests with a camera and a display that the kernel takes for real ones: `bash tests/vm/run.sh [TEST...]`, names of files in
# tests/; all of them without a name. `bash tests/vm/run.sh -- COMMAND` runs a command. FEATURES are those to build with, v4l
# and kms among them; ZONAL_VM_CHANGES is the number of changed patterns, ZONAL_VM_TIMEOUT_S how long the guest may take.
#
# QEMU (without KVM) boots a kernel of the distribution, unpacked under target/vm, and sees the host's files read-only.
# Nothing is installed but packages, nothing is skipped: what is missing is a failure.
set -euo pipefail
# Also in $(...).
shopt -s inherit_errexit

fail() {
    echo "tests/vm/run.sh: $1" >&2
    exit 1
}

# With those of other tests one build serves all.
features=${FEATURES:-v4l,kms}

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/../.."
vm=$PWD/target/vm

as_root() {
    if [[ $(id -u) == 0 ]]; then "$@"; else sudo -n "$@"; fi
}

# What is missing of these packages is installed.
install_packages() {
    local missing=() package
    for package in "$@"; do
        [[ $(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null) == installed ]] || missing+=("$package")
    done
    [[ ${#missing[@]} -gt 0 ]] || return 0
    echo "tests/vm/run.sh: installing ${missing[*]}" >&2
    { as_root apt-get update && as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "${missing[@]}"; } >&2 ||
        fail "packages are missing: apt install ${missing[*]}"
}

# Packages of that kernel which the distribution has now, by the packages that depend on the newest of a series.
kernel_packages() {
    local series found
    for series in linux-image-6.12-amd64 linux-image-amd64 linux-image-generic; do
        found=$(apt-cache depends "$series" 2>/dev/null | sed -nE 's/.*Depends: (linux-(image|modules|modules-extra)-[0-9].*)/\1/p' | sort -u)
        [[ -n $found ]] || continue
        echo "$found"
        # Where modules are packages of their own.
        for package in $found; do
            apt-cache depends "$package" | sed -nE 's/.*Depends: (linux-modules-[0-9].*)/\1/p'
        done
        return
    done
    fail "apt knows no kernel: run apt-get update"
}

# A machine that has never asked for packages knows none.
[[ -n $(apt-cache search --names-only '^linux-image-') ]] || as_root apt-get update >&2

# Gets packages into a folder.
download() {
    # shellcheck disable=SC2086 # one word each
    (cd "$1" && apt-get download $2 >&2)
}

# Downloads and unpacks a kernel unless that has been done. Prints where it is.
unpack_kernel() {
    local packages
    packages=$(kernel_packages | sort -u)
    local kernel=$vm/kernel had=""
    [[ ! -f $kernel/packages ]] || had=$(<"$kernel/packages")
    if [[ $had != "$packages" ]]; then
        echo "tests/vm/run.sh: unpacking $(tr '\n' ' ' <<<"$packages")" >&2
        rm -rf "$kernel.part"
        mkdir -p "$kernel.part/download"
        if ! download "$kernel.part/download" "$packages"; then
            # A list of yesterday names a kernel that was replaced since.
            as_root apt-get update >&2
            packages=$(kernel_packages | sort -u)
            download "$kernel.part/download" "$packages" || fail "the kernel cannot be downloaded: look at apt's sources"
        fi
        local package
        for package in "$kernel.part"/download/*.deb; do
            dpkg -x "$package" "$kernel.part"
        done
        rm -rf "$kernel.part/download" "$kernel"
        echo "$packages" >"$kernel.part/packages"
        mv "$kernel.part" "$kernel"
    fi
    echo "$kernel"
}

# Builds tests and what they run. Prints a line `NAME PATH` for each, in their order: the chain leaves its camera plugged in.
build() {
    local arguments=() name
    for name in "$@"; do
        arguments+=(--test "$name")
    done
    cargo build --release --locked --features "$features" --bin zonal --example twin_camera >&2
    cargo test --release --locked --features "$features" --no-run --message-format=json "${arguments[@]}" |
        python3 -c '
import json, sys
paths = {}
for line in sys.stdin:
    message = json.loads(line)
    if message.get("executable") and message["target"]["kind"] == ["test"]:
        paths[message["target"]["name"]] = message["executable"]
for name in sys.argv[1:]:
    print(name, paths[name])' "$@"
}

[[ $(uname -m) == x86_64 ]] || fail "this machine is no x86_64: the guest's programs are built for it"
command -v apt-get >/dev/null || fail "there is no apt-get here: run this on Debian or Ubuntu"
install_packages qemu-system-x86 busybox-static python3 v4l-utils

kernel=$(unpack_kernel)
modules=(virtio_pci virtio_net 9p 9pnet_virtio virtio-gpu vivid uvcvideo vhci-hcd)
if [[ ! -f $vm/initramfs || $here/init -nt $vm/initramfs || $here/initramfs.py -nt $vm/initramfs || $kernel/packages -nt $vm/initramfs ]]; then
    python3 -B "$here/initramfs.py" "$kernel" "$vm/initramfs" "${modules[@]}"
fi
guest=(python3 -B "$here/host.py" --timeout "${ZONAL_VM_TIMEOUT_S:-600}" --kernel "$(echo "$kernel"/boot/vmlinuz-*)" --initrd "$vm/initramfs")

if [[ ${1:-} == -- ]]; then
    shift
    exec "${guest[@]}" -- "$@"
fi

tests=("$@")
[[ ${#tests[@]} -gt 0 ]] || tests=(device_kms device_v4l device_chain)
built=$(build "${tests[@]}")
command='status=0'
while read -r name path; do
    [[ -n $name ]] || fail "no test was built"
    # One device, one test at a time.
    command+="; echo; echo == $name; '$path' --ignored --show-output --test-threads=1 | tee /run/tmp/said || status=1"
    command+="; grep -q 'test result: ok. [1-9]' /run/tmp/said || { echo '$name: no test passed'; status=1; }"
done <<<"$built"
target=${CARGO_TARGET_DIR:-target}/release
rig=optics/ghosh-2007-built.toml
calibration=$vm/calibration
if [[ " ${tests[*]} " == *" device_chain "* ]]; then
    for kind in response flat-field gray-card; do
        "$target/zonal" calibrate "$kind" "$rig" --simulate --out "$calibration" >&2
    done
fi
export ZONAL_VM_CALIBRATION=$calibration
exec "${guest[@]}" --twin "$target/examples/twin_camera $rig gray-card" -- "$command; exit \$status"
