#!/bin/sh
# monado.sh [FOLDER]: build Monado, an OpenXR runtime, for the tests of the headset, on Debian 12 as root (4 minutes on 2
# cores). In one process with the program, without service, GPU or headset: a scripted "remote" one is its only device.
# One line is patched in, so that what a controller would make the hand feel can be read: MONADO_HAPTIC on stderr.
set -eu
folder=${1:-$HOME/.cache/vrgs/monado}
[ -f "$folder/openxr_monado.json" ] && { echo "Monado is in $folder"; exit 0; }
version=25.0.0
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export DEBIAN_FRONTEND=noninteractive
log() { "$@" >"$work/log" 2>&1 || { tail -n 20 "$work/log" >&2; echo "monado.sh: this did not work: $1" >&2; exit 1; }; }

echo "building Monado $version (some minutes; once)"
log apt-get update
log apt-get install -y --no-install-recommends cmake ninja-build g++ pkg-config xz-utils libvulkan-dev libeigen3-dev \
    glslang-tools libx11-xcb-dev libxcb-randr0-dev libxrandr-dev libgl-dev libglx-dev libopengl-dev libegl-dev \
    libgles-dev libudev-dev mesa-vulkan-drivers libgl1-mesa-dri libglx-mesa0 libegl1 libgl1
# Debian 12 has an older Monado: the source package is Debian 13's, from the mirror that this machine uses.
mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Codename: bookworm' 'Created-By: Packages' | head -n 1)
mkdir -p "$work/lists/partial" "$work/source"
echo "deb-src [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] $mirror trixie main" >"$work/sources.list"
set -- -o "Dir::Etc::sourcelist=$work/sources.list" -o Dir::Etc::sourceparts=/dev/null -o "Dir::State::Lists=$work/lists" \
    -o APT::Sandbox::User=root
log apt-get "$@" update
(cd "$work" && log apt-get "$@" source --tar-only "monado=$version+dfsg-2")
tar xf "$work"/monado_*.orig.tar.xz -C "$work/source" --strip-components=1
felt='fprintf(stderr, "MONADO_HAPTIC %s %.3f %.1f\\n", rd->is_left ? "left" : "right", value->vibration.amplitude, value->vibration.duration_ns / 1e6);'
sed -i "s|^\t(void)rd;|\t$felt|" "$work/source/src/xrt/drivers/remote/r_device.c"
grep -q MONADO_HAPTIC "$work/source/src/xrt/drivers/remote/r_device.c" || { echo "monado.sh: the patch does not fit" >&2; exit 1; }
off=
for name in FEATURE_SERVICE FEATURE_DEBUG_GUI FEATURE_WINDOW_PEEK FEATURE_STEAMVR_PLUGIN FEATURE_TRACING FEATURE_SLAM \
    HAVE_OPENCV HAVE_WAYLAND HAVE_SDL2 HAVE_DBUS HAVE_HIDAPI HAVE_LIBUSB HAVE_GST HAVE_JPEG HAVE_BLUETOOTH \
    BUILD_DRIVER_VIVE BUILD_DRIVER_WMR BUILD_DRIVER_STEAMVR_LIGHTHOUSE BUILD_DRIVER_HDK BUILD_DRIVER_HYDRA \
    BUILD_DRIVER_PSMV BUILD_DRIVER_PSSENSE BUILD_DRIVER_NS BUILD_DRIVER_RIFT_S BUILD_DRIVER_ROKID \
    BUILD_DRIVER_XREAL_AIR BUILD_DRIVER_OPENGLOVES BUILD_DRIVER_TWRAP MODULE_MONADO_CLI MODULE_MONADO_GUI BUILD_SAMPLES; do
    off="$off -DXRT_$name=OFF"
done
# shellcheck disable=SC2086
log cmake -G Ninja -S "$work/source" -B "$work/build" -DCMAKE_BUILD_TYPE=Release -DCMAKE_C_FLAGS_RELEASE=-O1 \
    -DCMAKE_CXX_FLAGS_RELEASE=-O1 -DBUILD_TESTING=OFF -DBUILD_DOC=OFF $off
log ninja -C "$work/build" openxr_monado
mkdir -p "$folder"
cp "$work/build/src/xrt/targets/openxr/libopenxr_monado.so" "$folder/"
manifest='{"file_format_version": "1.0.0", "runtime": {"name": "Monado", "library_path": "./libopenxr_monado.so"}}'
echo "$manifest" >"$folder/.part" && mv "$folder/.part" "$folder/openxr_monado.json"
echo "Monado is in $folder"
