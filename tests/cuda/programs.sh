#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# programs.sh FLAGS_FILE [all]: compiles programs for a device, unoptimised, where nvcc is: the test of
# training steps, which includes most headers, and the lesson; or all tests and benchmarks too. So a
# change that breaks one is seen where there is no device. Arguments of their kernels must take as many
# bytes on a device as on the host: nvcc 13 makes some types with an empty member declared
# [[no_unique_address]] larger there, and the kernel reads what lies elsewhere.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
root=$here/../..
not_compiled="device_programs: skipped, no nvcc is there, so no program for a device was compiled"
. "$here/../device/find_nvcc.sh"
includes="-isystem /usr/include/eigen3 $(sed -n 's/^-isystem/-isystem /p' "$1" | tr '\n' ' ')"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
bad=0
# same_arguments PTX: the size on the host is the last template argument of run_kernel.
same_arguments() {
    awk '
        /[.]entry .*run_kernel/ { name = $0; sub(/.*[.]entry */, "", name); sub(/[(].*/, "", name) }
        /_param_0\[[0-9]+\]/ && name != "" {
            host = name; sub(/EEEvT_$/, "", host); sub(/.*L[my]/, "", host)
            device = $0; sub(/.*_param_0\[/, "", device); sub(/\].*/, "", device)
            if (host != device) {
                print "arguments of " host " bytes on the host, of " device " on a device: " name
                bad = 1
            }
            name = ""
        }
        END { exit bad }' "$1"
}
programs=$here/steps_device.cu
if [ "${2:-}" = all ]; then programs=$(echo "$here"/*_device.cu "$root"/benchmarks/cuda/*.cu); fi
# shellcheck disable=SC2086 # a list of files, whose names hold no spaces
for source in $programs "$root"/examples/*.cu; do
    quiet=20012,20015
    case ${source##*/} in # Eigen's Cholesky, which runs on the host
    labels_device.cu | refine.cu) quiet=$quiet,20014 ;;
    esac
    # shellcheck disable=SC2086 # the folders are several words
    if "$nvcc" -std=c++20 -G -ptx -arch=sm_80 --fmad=false -Werror all-warnings \
        -diag-suppress $quiet -DEIGEN_DONT_PARALLELIZE -I"$root/include" -I"$root/tests" \
        -I"$root/benchmarks" $includes -o "$work/program.ptx" "$source" > "$work/log" 2>&1; then
        echo "compiled ${source##*/}"
        same_arguments "$work/program.ptx" || bad=1
    else
        cat "$work/log"
        bad=1
    fi
done
exit $bad
