#!/usr/bin/env bash
# Builds the browser viewer into a folder that any web server can serve: `build.sh [FOLDER]`, default dist/ beside this
# script. Needs wasm-bindgen of the version below, and rustup's standard library for wasm32.
set -euo pipefail
cd "$(dirname "$0")"
folder="$(realpath -m "${1:-dist}")"
target=wasm32-unknown-unknown
wasm_bindgen_version=0.2.130

# Small before fast: the graphics device does the work, and the visitor waits for the download.
export CARGO_PROFILE_RELEASE_OPT_LEVEL=s CARGO_PROFILE_RELEASE_LTO=fat CARGO_PROFILE_RELEASE_CODEGEN_UNITS=1
export CARGO_PROFILE_RELEASE_DEBUG=false CARGO_PROFILE_RELEASE_STRIP=debuginfo CARGO_PROFILE_RELEASE_PANIC=abort
# A folder of its own: builds with another profile would replace each other.
export CARGO_TARGET_DIR="${CARGO_TARGET_DIR:-$PWD/../../target}/web"

if ! wasm-bindgen --version 2>/dev/null | grep -qF "$wasm_bindgen_version"; then
    echo "missing: cargo install wasm-bindgen-cli --version $wasm_bindgen_version" >&2
    exit 1
fi

if ! [ -d "$(rustc --print sysroot)/lib/rustlib/$target" ]; then
    echo "missing: rustup target add $target" >&2
    exit 1
fi
cargo build --release --locked --package dpges-web --target "$target"

mkdir -p "$folder/pkg"
wasm-bindgen --target web --no-typescript --remove-name-section --remove-producers-section --out-dir "$folder/pkg" "$CARGO_TARGET_DIR/$target/release/dpges_web.wasm"
cp page/* "$folder/"
echo "$folder: $(gzip -9c "$folder/pkg/dpges_web_bg.wasm" | wc -c) bytes of wasm after gzip"
