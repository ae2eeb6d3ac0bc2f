#!/bin/sh
# play_in_chroot.sh PROGRAM: play the ring toss with the one-file program where there is nothing but the C library and zlib.
# Status 0: it scored, and a second start found the kernels that the first had compiled. 77: this cannot be tried here.
set -eu
program=$1
skip() { echo "the one-file program was not tried in a chroot: $1" >&2; exit 77; }
[ "$(id -u)" = 0 ] || skip "chroot is for root"
command -v dpkg-query >/dev/null || skip "the libraries' files are looked up with dpkg"

tree=$(mktemp -d)
trap 'rm -rf "$tree"' EXIT
mkdir -p "$tree/tmp" "$tree/dev" "$tree/root" "$tree/usr/lib" "$tree/usr/lib64"
ln -s usr/lib "$tree/lib" && ln -s usr/lib64 "$tree/lib64"
dpkg-query -L libc6 zlib1g | grep -E '/lib.*\.so(\.[0-9]+)*$' | grep -v /gconv/ | while read -r library; do
    mkdir -p "$tree$(dirname "$library")" && cp -L "$library" "$tree$library"
done
mknod -m 666 "$tree/dev/null" c 1 3 && mknod -m 666 "$tree/dev/urandom" c 1 9 || skip "no devices can be made here"
if find "$tree" -iname '*python*' | grep .; then
    echo "there is a Python in the tree" >&2
    exit 1
fi
cp "$program" "$tree/vrgs"
play() { env -i HOME=/root PATH="$PATH" chroot "$tree" /vrgs "$@"; }
play --version >"$tree/version" 2>&1 || {
    grep -q 'chroot: ' "$tree/version" && skip "$(cat "$tree/version")"
    cat "$tree/version" >&2
    exit 1
}
echo "$(cat "$tree/version"), $(($(stat -c %s "$program") / 1000000)) MB"
kernels() { find "$tree/root/.cache" -name '*.tic' | wc -l; }
set -- --scene ring_toss --headless --arch cpu --size 160x90 --snapshot /ring_toss.png
begin=$(date +%s)
play "$@" --stats /ring_toss.json
compiled=$(kernels)
echo "played in $(($(date +%s) - begin)) s; $compiled kernels compiled"
[ -s "$tree/ring_toss.png" ] || { echo "there is no picture" >&2; exit 1; }
grep -Eq '"score": *[1-9]' "$tree/ring_toss.json" || { echo "no ring was thrown over the bottle" >&2; exit 1; }
begin=$(date +%s)
play "$@" --frames 1
echo "second start in $(($(date +%s) - begin)) s"
[ "$compiled" -gt 0 ] && [ "$(kernels)" = "$compiled" ] || { echo "kernels were compiled again" >&2; exit 1; }
