# SPDX-License-Identifier: Apache-2.0
# shellcheck shell=sh disable=SC2034
# steps.sh: what the scripts of this folder share; they read it with `.` from the project's root.

begin=$(date +%s)
jobs=${JOBS:-$(nproc 2> /dev/null || echo 2)}

# Threads of a program that waits leave the processors to the others.
export OMP_WAIT_POLICY="${OMP_WAIT_POLICY:-passive}"

# Without these ccache keeps no unit that has a precompiled header.
export CCACHE_SLOPPINESS="${CCACHE_SLOPPINESS:-pch_defines,time_macros}"

seconds_since() { echo $(($(date +%s) - $1)); }

# step TITLE COMMAND...: says what is done, does it, says how long it took. A failure ends the script.
step() {
    step_title=$1
    shift
    step_begin=$(date +%s)
    printf '\n== %s\n   %s\n' "$step_title" "$*"
    if "$@"; then
        printf '== %s: done in %s s\n' "$step_title" "$(seconds_since "$step_begin")"
    else
        step_status=$?
        printf '== %s: FAILED after %s s\n' "$step_title" "$(seconds_since "$step_begin")" >&2
        exit "$step_status"
    fi
}

# configure BUILD_DIR OPTIONS...: with ninja and ccache where there are any.
configure() {
    configure_dir=$1
    shift
    if command -v ninja > /dev/null 2>&1 && [ ! -e "$configure_dir/CMakeCache.txt" ]; then
        set -- -G Ninja "$@"
    fi
    if command -v ccache > /dev/null 2>&1; then
        set -- -DCMAKE_CXX_COMPILER_LAUNCHER=ccache "$@"
    fi
    cmake -S . -B "$configure_dir" "$@"
}
