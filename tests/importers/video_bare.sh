#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# video_bare.sh ARCHIVE VIDEO WORK [SUITE...]: from a video to an avatar as a new user does it: on bare
# systems (bookworm and trixie) unpacks ARCHIVE, the programs of a release, types what docs/video.md says
# under "What to install", then `rye avatar VIDEO`, and prints the seconds of each step. A system that
# cannot be had is named. From the environment:
#   RYE_FACE_LANDMARKER   the tracker's model, where it cannot be fetched as the page says
#   NODE_EXTRA_CA_CERTS   certificates that this network asks for; npm in there takes them, too
#   PRESET                of the training (tiny)
set -eu
[ $# -ge 3 ] || { echo "video_bare.sh: expected ARCHIVE VIDEO WORK [SUITE...]" >&2; exit 2; }
here=$(cd "$(dirname "$0")/../.." && pwd)
mkdir -p "$3/carried"
work=$(cd "$3" && pwd)
cp "$1" "$work/carried/programs.tar.gz"
cp "$2" "$work/carried/head.mp4"
rm -f "$work/carried/face_landmarker.task"
[ -z "${RYE_FACE_LANDMARKER:-}" ] || cp "$RYE_FACE_LANDMARKER" "$work/carried/face_landmarker.task"
rm -f "$work/carried/certificates.crt"
[ ! -f "${NODE_EXTRA_CA_CERTS:-}" ] || cp "$NODE_EXTRA_CA_CERTS" "$work/carried/certificates.crt"
cat > "$work/carried/user.sh" << 'END'
set -eu
echo 'APT::Get::Assume-Yes "true";' > /etc/apt/apt.conf.d/90yes
export DEBIAN_FRONTEND=noninteractive
begin=$(date +%s)
step() { echo "$1: $(($(date +%s) - begin)) s"; begin=$(date +%s); }
mkdir /root/user
cd /root/user
mkdir programs
tar -xzf /rye/carried/carried/programs.tar.gz -C programs --strip-components=1
cp /rye/carried/carried/head.mp4 .
awk '/^## /{on = $0 ~ /What to install/} on && /^```/{++ticks; next} on && ticks == 1' /rye/docs/video.md > install.sh
[ -s install.sh ] || { echo "docs/video.md says nothing of what to install"; exit 1; }
if [ -e /rye/carried/carried/face_landmarker.task ]; then
    grep -v '^curl ' install.sh > less.sh
    mv less.sh install.sh
    cp /rye/carried/carried/face_landmarker.task .
fi
if [ -e /rye/carried/carried/certificates.crt ]; then
    export npm_config_cafile=/rye/carried/carried/certificates.crt
fi
cat install.sh
apt-get update > update.txt 2>&1 || { tail -n 3 update.txt; exit 77; }
sh -e install.sh > install.txt 2>&1 || { tail -n 5 install.txt; exit 1; }
step "installed"
programs/rye avatar head.mp4 --out head.avatar --preset "$1" > avatar.txt 2>&1 || { tail -n 5 avatar.txt; exit 1; }
step "avatar by $1"
tail -n 3 avatar.txt
[ -s head.avatar ] && [ -s head.png ]
END
shift 3
[ $# -gt 0 ] || set -- bookworm trixie
failed=0
for suite; do
    status=0
    BUILD=$work CARRY=$work/carried sh "$here/tests/bare.sh" "$suite" sh carried/carried/user.sh "${PRESET:-tiny}" \
        > "$work/$suite.video" 2>&1 || status=$?
    case $status in
    0) echo "$suite:"; cat "$work/$suite.video" ;;
    77) echo "not run: a video on $suite: $(tail -n 1 "$work/$suite.video")" ;;
    *) tail -n 20 "$work/$suite.video"; failed=1 ;;
    esac
done
exit $failed
