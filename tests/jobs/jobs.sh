#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# jobs.sh RYE WORK: 24 runs of `rye compare --emit` by GNU parallel and by Slurm's job arrays, with its
# daemons on this machine; in each a task is killed while it trains, and Slurm's node vanishes once.
# The tables and checkpoints are those of `rye compare --jobs`. Slurm's daemons need root, and ports
# 26817 and 26818.
set -eu
rye=$1
work=$2
rm -rf "$work"
mkdir -p "$work"
cd "$work"
work=$PWD
begin=$(date +%s)

fail() { echo "FAILED: $*" >&2; exit 1; }
same() { cmp "$1" "$2" || fail "$1 and $2 differ"; }

started='' parallel=''
end_all() { # daemons in reverse
    [ -z "$parallel" ] || kill "$parallel" 2> /dev/null || true
    for name in $started; do
        [ ! -s "$work/slurm/$name.pid" ] || kill "$(cat "$work/slurm/$name.pid")" 2> /dev/null || true
    done
}
trap end_all EXIT
trap 'exit 1' INT TERM

for name in one two; do
    "$rye" capture --out "$name" --size 64 --cameras 3 --frames 3 --test-frames 1 --apart-frames 1 \
        --samples 1 --quiet
done
cat > list.json << 'JSON'
{"title": "24 runs", "preset": "tiny", "captures": ["one", "two"], "seeds": [1, 2, 3],
 "base": {
  "avatar": {"feature": 8, "channels": 8,
   "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
  "grid": {"cell": 0.35},
  "mesh": {"steps": 8, "image_size": 32, "pretrain_steps": 40, "fit_steps": 20},
  "gaussians": {"steps": 80, "mouth_points": 20, "panel_every": 0, "checkpoint_every": 10,
   "spacing": 0, "eyeball": {"points": 120}, "upsampler": {"capacity": 2}}},
 "rows": [{"name": "as it is"},
          {"name": "coarse", "config": {"grid": {"cell": 0.4}}},
          {"name": "no blank loss", "config": {"gaussians": {"weights": {"blank": 0}}}},
          {"name": "no eyeball loss",
           "config": {"gaussians": {"weights": {"eye_low": 0, "eye_high": 0}}}}]}
JSON

"$rye" compare --list "$work/list.json" --out by_jobs --jobs 2 --threads 1 > by_jobs.txt
echo "--jobs: $(($(date +%s) - begin)) s"

# process_of CLAIM: its holder.
process_of() { sed -n '2s/^process \([0-9]*\) .*/\1/p' "$1" 2> /dev/null || true; }

# kill_a_task OUT: kills the process of a task of OUT that trains stage 2, and names its run.
kill_a_task() {
    for try in $(seq 1 3000); do
        for claim in "$1"/runs/*/no_blank_loss/seed_*/task.claim; do
            run=${claim%/task.claim}
            # It has a checkpoint, but no picture was measured yet.
            if [ ! -e "$run/checkpoint.safetensors" ] || [ -e "$run/evaluation_test" ]; then continue; fi
            pid=$(process_of "$claim")
            if [ -n "$pid" ] && kill -KILL "$pid" 2> /dev/null; then
                echo "killed process $pid of $run"
                return
            fi
        done
        sleep 0.02
    done
    fail "no task of $1 was seen training"
}

# compared OUT SECONDS: the tables of OUT are those of --jobs, and so is every checkpoint.
compared() {
    "$rye" compare --collect --out "$1" > "$1.txt" 2> "$1.err" || { cat "$1.err"; fail "$1 is not complete"; }
    for file in list.md list.csv list_runs.csv list_one.png list_two.png; do
        same "by_jobs/$file" "$1/$file"
    done
    count=0
    for file in by_jobs/runs/*/*/seed_*/checkpoint.safetensors; do
        same "$file" "$1${file#by_jobs}"
        count=$((count + 1))
    done
    [ $count = 24 ] || fail "$count runs"
    echo "$1: $2 s; 24 runs, tables and checkpoints are those of --jobs"
}

# ---- GNU parallel --------------------------------------------------------------------------------
if command -v parallel > /dev/null && parallel --version 2> /dev/null | grep -q GNU; then
    "$rye" compare --list "$work/list.json" --out by_parallel --jobs 2 --threads 1 --emit parallel
    since=$(date +%s)
    sh by_parallel/parallel.sh > parallel.txt 2> parallel.err &
    parallel=$!
    kill_a_task by_parallel
    code=0
    "$rye" compare --collect --out by_parallel > partial.txt 2> partial.err || code=$?
    [ $code = 1 ] || fail "code $code of tables that are not complete, expected 1"
    grep -q "of 24 runs are not in the tables$" partial.err || { cat partial.err; fail "no number of missing runs"; }
    grep -q "^not run: .*: not begun$" by_parallel/list.md || { cat by_parallel/list.md; fail "no run that is missing"; }
    wait $parallel || { cat parallel.txt parallel.err; fail "parallel.sh"; }
    parallel=''
    compared by_parallel $(($(date +%s) - since))
    [ "$(awk 'NR > 1 && ($7 != 0 || $8 != 0)' by_parallel/jobs/tasks.txt | wc -l)" = 0 ] ||
        { cat by_parallel/jobs/tasks.txt; fail "a task has failed"; }
else
    echo "not run: tasks by GNU parallel: parallel is not installed"
fi

# ---- Slurm ---------------------------------------------------------------------------------------
for program in slurmctld slurmd munged sbatch; do
    if ! PATH=$PATH:/usr/sbin command -v $program > /dev/null; then
        echo "not run: tasks by Slurm: slurm is not installed ($program; Debian: slurm-wlm munge)"
        exit 0
    fi
done
if [ "$(id -u)" != 0 ]; then
    echo "not run: tasks by Slurm: its daemons need root"
    exit 0
fi
PATH=$PATH:/usr/sbin
host=$(hostname -s)
mkdir -p slurm/state slurm/spool
chmod 700 slurm
(umask 077 && head -c 1024 /dev/urandom > slurm/munge.key)
# A task that goes back to the queue waits until its credential has ended: 5 s instead of 120.
cat > slurm/slurm.conf << CONF
ClusterName=rye
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
SlurmdUser=root
SlurmctldPort=26817
SlurmdPort=26818
AuthType=auth/munge
AuthInfo=socket=$work/slurm/munge.socket,cred_expire=5
CredType=cred/munge
StateSaveLocation=$work/slurm/state
SlurmdSpoolDir=$work/slurm/spool
SlurmctldPidFile=$work/slurm/slurmctld.pid
SlurmdPidFile=$work/slurm/slurmd.pid
SlurmctldLogFile=$work/slurm/slurmctld.log
SlurmdLogFile=$work/slurm/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
ReturnToService=2
SlurmdTimeout=10
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=sched_min_interval=100000,batch_sched_delay=0
SlurmdParameters=config_overrides
NodeName=$host NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF
export SLURM_CONF="$work/slurm/slurm.conf"
munged --force --socket="$work/slurm/munge.socket" --key-file="$work/slurm/munge.key" \
    --pid-file="$work/slurm/munged.pid" --log-file="$work/slurm/munged.log" \
    --seed-file="$work/slurm/munged.seed"
started=munged
slurmctld -f "$SLURM_CONF" -c 2> slurm/ctld.err || { cat slurm/ctld.err; fail "slurmctld"; }
started="slurmctld $started"
slurmd -f "$SLURM_CONF" 2> slurm/d.err || { cat slurm/d.err; fail "slurmd"; }
started="slurmd $started"
node_is() { # STATE...: waits for one of them
    for try in $(seq 1 300); do
        state=$(sinfo --noheader --format %T 2> /dev/null || true)
        case " $* " in *" ${state:-unknown} "*) return ;; esac
        sleep 0.2
    done
    tail -20 slurm/slurmctld.log slurm/slurmd.log
    fail "the node is $state, expected $*"
}
node_is idle

"$rye" compare --list "$work/list.json" --out by_slurm --threads 1 --emit slurm --with "--time=10"
since=$(date +%s)
sh by_slurm/submit.sh
sh by_slurm/submit.sh > again.txt
grep -q "are in the queue as rye-[0-9a-f]* already$" again.txt || { cat again.txt; fail "submitted twice"; }
kill_a_task by_slurm
# The node vanishes, with all that works there, and comes back when Slurm has given it up.
parent_of() { [ -z "$1" ] || ps -o ppid= -p "$1" 2> /dev/null | tr -d ' '; }
gone=0
while [ $gone = 0 ]; do
    for claim in by_slurm/runs/*/*/seed_*/task.claim; do
        pid=$(process_of "$claim")
        [ -n "$pid" ] || continue
        script=$(parent_of "$pid")
        step=$(parent_of "$script")
        case $(ps -o args= -p "${step:-1}" 2> /dev/null || true) in slurmstepd*) ;; *) continue ;; esac
        [ $gone != 0 ] || kill -KILL "$(cat slurm/slurmd.pid)"
        # shellcheck disable=SC2046 # numbers
        kill -KILL "$step" "$script" $(ps -o pid= --ppid "$pid") "$pid" 2> /dev/null || true
        gone=$((gone + 1))
    done
    sleep 0.1
done
echo "the node vanished with $gone tasks"
node_is down down\*
slurmd -f "$SLURM_CONF"
for try in $(seq 1 1200); do
    [ -n "$(squeue --noheader)" ] || break
    [ "$try" != 1200 ] || { squeue; cat by_slurm/jobs/*; fail "the queue is not empty after 4 minutes"; }
    sleep 0.2
done
compared by_slurm $(($(date +%s) - since))
back=$(grep -ci requeu slurm/slurmctld.log || true)
[ "$back" -gt "$gone" ] || fail "$back words of tasks that went back to the queue, expected more than $gone"
"$rye" compare --list "$work/list.json" --out by_slurm --threads 1 --emit slurm > again.txt
grep -q "^24 runs, 0 of them to do" again.txt || { cat again.txt; fail "done again"; }
sh by_slurm/submit.sh | grep -qx "all runs are complete" || fail "complete runs are submitted"
echo "24 runs by GNU parallel and by Slurm have the tables of --jobs: $(($(date +%s) - begin)) s"
