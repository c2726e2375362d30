#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# shell_files.sh RYE BUILD_DIR CMAKE WORK: what `cmake --install` puts beside the program: completion
# scripts, which the shells that are here load and use, and the manual page, which groff checks and
# which names every command and option of --help.
set -eu
rye=$1
build=$2
cmake=$3
work=$4
rm -rf "$work"
mkdir -p "$work/here/a folder"
: > "$work/here/a picture.png"
fail() { echo "FAILED: $*" >&2; exit 1; }

"$cmake" --install "$build" --prefix "$work/prefix" --component programs > "$work/install.txt"
share=$work/prefix/share
bash=$share/bash-completion/completions/rye
zsh=$share/zsh/site-functions/_rye
fish=$share/fish/vendor_completions.d/rye.fish
manual=$share/man/man1/rye.1
for file in "$bash" "$zsh" "$fish" "$manual" "$work/prefix/bin/rye"; do
    [ -s "$file" ] || fail "cmake --install installs no $file"
done
"$rye" completion bash | cmp - "$bash" || fail "the installed script is not the program's"

# Every command and every option of the help, in all four.
commands=$("$rye" --help | sed -n '/^Subcommands:/,/^$/s/^  \([a-z]*\) .*/\1/p')
[ "$(echo "$commands" | wc -w)" -ge 10 ] || fail "the help lists these commands only: $commands"
options=0
for command in $commands; do
    for file in "$bash" "$zsh" "$fish" "$manual"; do
        grep -q "\b$command\b" "$file" || fail "$file has no $command"
    done
    for option in $("$rye" "$command" --help |
                    sed -n 's/^  \(-h,\)\{0,1\}--\([a-z-]*\).*/\2/p'); do
        options=$((options + 1))
        # shellcheck disable=SC2016
        grep -q -- "--$option\b" "$bash" && grep -q -- "--$option\[" "$zsh" &&
            grep -q -- "from $command' -l $option\b" "$fish" || fail "no --$option of $command"
        grep -q -- "$(echo "--$option" | sed 's/-/\\\\-/g')" "$manual" ||
            fail "the manual has no --$option of $command"
    done
done
[ $options -ge 50 ] || fail "the help lists $options options only"

cd "$work/here"
# completes EXPECTED: words in any order; of `of`, the answer of a shell.
completes() {
    got=$(echo "$of" | LC_ALL=C sort | tr '\n' ' ')
    [ "$got" = "$1 " ] || fail "$line completes to '$got', expected '$1 '"
}
if command -v bash > /dev/null 2>&1; then
    # by_bash WORD...: the last one is what is completed.
    by_bash() {
        line="bash: $*"
        of=$(bash -c '. "$0"; compopt() { :; }
            COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _rye; printf "%s\n" "${COMPREPLY[@]}"' \
            "$bash" "$@")
    }
    by_bash rye tra; completes train
    by_bash rye redirect --swe; completes --sweep
    by_bash rye train --preset ''; completes 'cpu gpu paper paper-literal tiny'
    by_bash rye train --device ''; completes 'auto cpu cuda'
    by_bash rye redirect --out 'a '; completes 'a folder a picture.png'
    by_bash rye redirect --run 'a'; completes 'a folder'
    by_bash rye completion f; completes fish
else
    echo "not run: completion by bash, which is not installed"
fi
if command -v zsh > /dev/null 2>&1; then
    zsh -n "$zsh" || fail "zsh cannot parse $zsh"
    # A terminal of zsh's own, in which Tab is pressed.
    cat > "$work/tab.zsh" << 'END'
zmodload zsh/zpty
zpty z zsh -f -i
zpty -w z "PS1=; fpath=($1 \$fpath); autoload -Uz compinit; compinit -u -D; bindkey '^I' complete-word"
zpty -w z "rye() { print -r -- GOT \$@ }; print READ''Y"
zpty -r -m z out '*READY*'
zpty -w -n z "rye $2"$'\t'
sleep 1
zpty -w z ""
zpty -w z "print DO''NE"
zpty -r -m z out '*DONE*'
print -r -- $out
END
    line="zsh: rye redirect --swe"
    timeout 60 zsh -f "$work/tab.zsh" "$(dirname "$zsh")" "redirect --swe" > "$work/tab.txt" 2>&1 || true
    grep -q "GOT redirect --sweep" "$work/tab.txt" || { cat "$work/tab.txt"; fail "$line"; }
else
    echo "not run: completion by zsh, which is not installed"
fi
if command -v fish > /dev/null 2>&1; then
    by_fish() {
        line="fish: $1"
        of=$(HOME=$work fish --no-config -c "source '$fish'; complete -C '$1'" | cut -f 1)
    }
    by_fish 'rye tra'; completes train
    by_fish 'rye redirect --swe'; completes --sweep
    by_fish 'rye train --preset '; completes 'cpu gpu paper paper-literal tiny'
    by_fish 'rye redirect --run '; completes 'a folder/'
    by_fish 'rye completion f'; completes fish
else
    echo "not run: completion by fish, which is not installed"
fi
if command -v groff > /dev/null 2>&1; then
    groff -man -Tutf8 -ww -z "$manual" > "$work/groff.txt" 2>&1
    [ ! -s "$work/groff.txt" ] || { cat "$work/groff.txt"; fail "groff warns of the manual"; }
else
    echo "not run: the manual by groff, which is not installed"
fi
echo "1 passed, 0 failed: $(echo "$commands" | wc -w) commands, $options options"
