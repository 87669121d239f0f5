#!/usr/bin/env bash
# Runs the README's two commands in a minimal Debian: debootstrap's smallest variant with a C toolchain, and this machine's
# Rust. Needs root, debootstrap, and some 4 GB below target/.
#
#   tests/minimal_root.sh [SUITE [MIRROR]]        default: bookworm http://deb.debian.org/debian
#
# The commit that is checked out is tested, as a clone of it. What the root has is what debootstrap puts there: nothing of this
# machine is in it but the Rust toolchain, the registry's settings and the network's (resolv.conf, certificates, proxies).
set -euo pipefail
suite=${1:-bookworm} mirror=${2:-http://deb.debian.org/debian}
here=$(cd "$(dirname "$0")/.." && pwd)
root=$here/target/minimal_root/$suite

fail() { echo "tests/minimal_root.sh: $*" >&2; exit 1; }

[ "$(id -u)" = 0 ] || fail "run it as root: it changes its root folder"
command -v debootstrap >/dev/null || fail "debootstrap is missing (Debian, Ubuntu: apt-get install debootstrap)"
toolchain=$(rustc --print sysroot) || fail "no Rust"
cargo_home=${CARGO_HOME:-$HOME/.cargo}

# The first fenced blocks after these lines of the README.
block() { awk -v mark="$1" 'index($0, mark) {wanted = 1} wanted && /^```$/ {exit} fenced {print} wanted && /^```sh$/ {fenced = 1}' "$here/README.md"; }
frame_command=$(block '**This frame**') test_command=$(block '<!-- the tests -->')
[ -n "$frame_command" ] && [ -n "$test_command" ] || fail "README.md has no commands"

# A new root each time: packages of an earlier run would hide what is missing.
rm -rf "$root"
mkdir -p "$root"
debootstrap --variant=minbase --include=gcc,libc6-dev,ca-certificates "$suite" "$root" "$mirror" >"$root.log" 2>&1 ||
    { tail -5 "$root.log" >&2; fail "debootstrap failed; see $root.log"; }
cp -L /etc/resolv.conf "$root/etc/resolv.conf"
[ ! -e /etc/ssl/certs/ca-certificates.crt ] || cp -L /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"
mkdir -p "$root/rust" "$root/root/.cargo"
for settings in "$cargo_home"/config.toml "$cargo_home"/credentials.toml; do
    [ ! -e "$settings" ] || cp "$settings" "$root/root/.cargo/"
done
git clone --quiet "$here" "$root/root/regolith-render"

# Mounts of their own, which end with the command.
run() {
    echo "+ $1"
    unshare --mount --pid --fork bash -c '
        mount --bind "$2" "$1/rust" && mount --rbind /dev "$1/dev" && mount -t proc proc "$1/proc" &&
        exec chroot "$1" /usr/bin/env -i HOME=/root PATH=/rust/bin:/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive \
            ${http_proxy:+http_proxy="$http_proxy"} ${https_proxy:+https_proxy="$https_proxy"} \
            bash -euc "cd /root/regolith-render; $3"
    ' minimal_root "$root" "$toolchain" "$1"
}

run "$frame_command"
[ -s "$root/root/regolith-render/out/semantic_segmentation_0000.png" ] || fail "the first command left no mask in out/"
run "$test_command"
echo "tests/minimal_root.sh: both commands of the README pass in $suite"
