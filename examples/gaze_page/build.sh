#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# build.sh [AVATAR [OUT]]: the gaze page as one folder of files, OUT (build/gaze_page), to put on any
# host, or to open from a disk: the page, rye as WebAssembly with SIMD, of one thread and of several
# (rye_threads.*), the avatar file, and this and the module of one thread once more in files.js, for
# browsers read no other files from a disk; and OUT/npm, a package. Without AVATAR, or with "-", the avatar
# is left out, and the page asks for a file. Needs emscripten (Debian: apt-get install emscripten), Eigen
# and xsimd; installs nothing. From the environment:
#   EIGEN, XSIMD   folders of these
#   POSTER         a picture that the page shows until the first of its own; what is no .webp is
#                  converted by ffmpeg
#   MEDIAPIPE      a folder that npm made of @mediapipe/tasks-vision, and
#   LANDMARKER     face_landmarker.task: with both, the page's camera finds the visitor's face, and the
#                  page may reach its own host alone
#   MORE           a source in C that is linked as well, for tests
set -eu
here=$(cd "$(dirname "$0")" && pwd)
root=$here/../..
avatar=${1:--}
out=${2:-$root/build/gaze_page}

fail() { echo "build.sh: $1" >&2; exit 1; }
command -v em++ > /dev/null || fail "no em++; install emscripten"
[ "$avatar" = - ] || [ -f "$avatar" ] || fail "got the avatar '$avatar', expected a file that \`rye export\` wrote"

eigen=${EIGEN:-/usr/include/eigen3}
xsimd=${XSIMD:-/usr/include/xsimd}
[ -d "$eigen/Eigen" ] || fail "no Eigen in $eigen; name its folder in EIGEN"
[ -d "$xsimd" ] || fail "no xsimd in $xsimd; name its folder in XSIMD"

poster=${POSTER:-}
[ -z "$poster" ] || [ -f "$poster" ] || fail "got the poster '$poster', expected a picture"
mediapipe=${MEDIAPIPE:-}
landmarker=${LANDMARKER:-}
[ -z "$mediapipe" ] || [ -f "$mediapipe/vision_bundle.mjs" ] ||
    fail "got MEDIAPIPE '$mediapipe', expected a folder with vision_bundle.mjs (npm install --ignore-scripts @mediapipe/tasks-vision@1.1.0)"
[ -z "$mediapipe" ] || [ -f "$landmarker" ] || fail "got LANDMARKER '$landmarker', expected face_landmarker.task"

mkdir -p "$out/objects/headers"
# The folder above xsimd's has headers of the host's C library, which must not be seen.
ln -sfn "$xsimd" "$out/objects/headers/xsimd"
# xsimd before 11.2 has no vectors of WebAssembly, but emscripten has SSE4.1 in terms of them. Eigen
# includes headers of x86 that emscripten lacks; rye's own lanes do the work.
flags="-O2 -msimd128 -msse4.1 -fwasm-exceptions -DNDEBUG -DRYE_C_STATIC -DEIGEN_DONT_VECTORIZE"
flags="$flags -DEIGEN_DONT_PARALLELIZE -include $here/simd.h -I$root/include -isystem $out/objects/headers -isystem $eigen"
# emscripten 3.1.6 looks for acorn where Debian's own node does; other nodes have to be told.
NODE_PATH=${NODE_PATH:-}${NODE_PATH:+:}/usr/share/nodejs
export NODE_PATH

# begin COMMAND...: in the background; all_done ends the script if one of these failed.
running=
begin() {
    "$@" &
    running="$running $!"
}
all_done() {
    for pid in $running; do wait "$pid" || exit 1; done
    running=
}

objects=
for source in "$root/c/cloud.cpp" "$root/c/avatar.cpp" "$root/c/message.cpp" "$here/rules.cpp" \
    "$here/page.c" ${MORE:+"$MORE"}; do
    object=$out/objects/$(basename "$source").o
    objects="$objects $object"
    # Once more only where a source or a header is newer.
    if [ -f "$object" ] && [ -z "$(find "$root/include" "$root/c" "$here" -newer "$object" \
        \( -name '*.[ch]pp' -o -name '*.[ch]' -o -name build.sh \) -print -quit)" ]; then
        continue
    fi
    # shellcheck disable=SC2086 # a list of options
    case $source in
        *.cpp) begin em++ -std=c++20 -pthread $flags -c "$source" -o "$object" ;;
        *) begin emcc -std=c11 -pthread $flags -c "$source" -o "$object" ;;
    esac
done
all_done
# link NAME EXPORT [FLAG...]: the same objects are both modules: a pool goes on with the threads that start,
# which is none without -pthread here.
link() {
    name=$1
    export=$2
    shift 2
    # shellcheck disable=SC2086 # lists
    begin em++ $flags "$@" $objects -o "$out/$name.js" -sALLOW_MEMORY_GROWTH=1 -sINITIAL_MEMORY=67108864 \
        -sENVIRONMENT=worker -sMODULARIZE=1 -sEXPORT_NAME="$export" -sFILESYSTEM=0 \
        -sEXPORTED_FUNCTIONS=_malloc,_free -sEXPORTED_RUNTIME_METHODS=UTF8ToString,stringToUTF8
}
link rye ryeModule
# worker.js says how many threads, and has the memory. Views of it are short-lived, so it may grow.
link rye_threads ryeThreadsModule -pthread -Wno-pthreads-mem-growth -sMAXIMUM_MEMORY=2147483648 \
    -sPTHREAD_POOL_SIZE=Module.threads-1 -sPTHREAD_POOL_SIZE_STRICT=2
all_done

# WebGPU's steps, and what calls them, as one script.
{
    echo 'const ryeShaders = {'
    for shader in "$here"/webgpu/*.wgsl; do
        # shellcheck disable=SC2016 # a text of JavaScript, not of a shell
        if grep -q '[\\$]' "$shader"; then fail "$shader: got \\ or \$, expected neither"; fi
        printf '%s: `' "$(basename "$shader" .wgsl)"
        # shellcheck disable=SC2016 # likewise
        sed 's/`/\\`/g' "$shader"
        echo '`,'
    done
    echo '};'
    cat "$here/webgpu/device.js" "$here/webgpu/splats.js" "$here/webgpu/network.js" "$here/webgpu/drawing.js"
} > "$out/webgpu.js"

for file in style.css page.js worker.js camera.js face.js visitor.js; do
    cp "$here/$file" "$out/$file"
done
rm -f "$out/poster.webp"
case $poster in
    '') ;;
    *.webp) cp "$poster" "$out/poster.webp" ;;
    *)
        command -v ffmpeg > /dev/null || fail "$poster: got no .webp, expected ffmpeg to convert it"
        ffmpeg -v error -y -i "$poster" -frames:v 1 "$out/poster.webp" < /dev/null ||
            fail "$poster: ffmpeg did not read it as a picture, or writes no .webp"
        ;;
esac
rm -rf "$out/mediapipe"
if [ -n "$mediapipe" ]; then
    mkdir -p "$out/mediapipe/wasm"
    cp "$mediapipe/vision_bundle.mjs" "$landmarker" "$out/mediapipe/"
    [ "$(basename "$landmarker")" = face_landmarker.task ] ||
        mv "$out/mediapipe/$(basename "$landmarker")" "$out/mediapipe/face_landmarker.task"
    cp "$mediapipe"/wasm/vision_wasm_internal.* "$out/mediapipe/wasm/"
fi
policy="connect-src 'self' data: blob:"
sed -e "s|<!-- visitor -->|<script src=\"face.js\"></script><script src=\"visitor.js\"></script>|" \
    ${poster:+-e 's|<!-- poster -->|<img class="poster" id="poster" src="poster.webp" alt="">|'} \
    ${mediapipe:+-e "s|<title>|<meta http-equiv=\"Content-Security-Policy\" content=\"$policy\">&|"} \
    "$here/index.html" > "$out/index.html"
# The same as a package for npm, whose example is npm/example.html.
mkdir -p "$out/npm"
version=$(sed -n 's/#define RYE_VERSION_[A-Z]* \([0-9]*\)/\1/p' "$root/include/rye/core/config.hpp" | paste -sd .)
cp "$here"/npm/* "$here/worker.js" "$out"/rye.* "$out"/rye_threads.* "$out/webgpu.js" "$root/LICENSE" "$out/npm/"
sed "s/\"version\": \"[^\"]*\"/\"version\": \"$version\"/" "$here/npm/package.json" > "$out/npm/package.json"
rm -f "$out/head.avatar" "$out/npm/head.avatar"
[ "$avatar" = - ] || cp "$avatar" "$out/head.avatar"
[ "$avatar" = - ] || cp "$avatar" "$out/npm/head.avatar"
{
    echo '// SPDX-License-Identifier: Apache-2.0'
    echo '// files.js: what page.js reads instead of files where it was opened from a disk, as base64.'
    echo '"use strict";'
    echo 'window.ryeFiles = {'
    for file in rye.js webgpu.js worker.js rye.wasm head.avatar; do
        [ ! -f "$out/$file" ] || printf '"%s": "%s",\n' "$file" "$(base64 < "$out/$file" | tr -d '\n')"
    done
    echo '};'
} > "$out/files.js"
printf 'gaze page: %s\n' "$out"
for file in rye.wasm rye.js rye_threads.wasm rye_threads.js webgpu.js head.avatar files.js; do
    [ ! -f "$out/$file" ] || printf '  %s %s bytes, %s compressed\n' "$file" \
        "$(wc -c < "$out/$file")" "$(gzip -9c "$out/$file" | wc -c)"
done
