#!/bin/sh
# Acceptance of a GPU: proofs first, then times, one line a row. Needs a POSIX shell and the pack
# (`cargo xtask accept-gpu --pack`), no toolchain, network or display. docs/gpu-acceptance.md.
#
# usage: accept.sh [--device gpu|cpu|gpu:N] [--small] [--out FOLDER] [--pack FOLDER]
set -u
device=gpu small=0 out=accept pack=$(dirname "$0")
while [ $# -gt 0 ]; do
    case $1 in
    --device) device=$2 && shift 2 ;;
    --small) small=1 && shift ;;
    --out) out=$2 && shift 2 ;;
    --pack) pack=$2 && shift 2 ;;
    *) echo "accept.sh: no option $1" >&2 && exit 2 ;;
    esac
done
intima=$pack/intima
[ -x "$intima" ] || { echo "accept.sh: no program at $intima" >&2 && exit 2; }
if [ -e "$out" ] && [ ! -f "$out/table.txt" ]; then
    echo "accept.sh: $out is there, and not of an acceptance" >&2 && exit 2
fi
rm -rf "$out" && mkdir -p "$out/work" || exit 2
table=$out/table.txt log=$out/log.txt failed=0
: >"$table"

# Sizes: all of it, or enough to find a mistake in this script.
if [ $small = 1 ]; then
    ball=48 bench=32 frames=4 short=2 width=160x90 window=4 rounds=1
else
    ball=512 bench=256 frames=400 short=100 width=640x360 window=300 rounds=3
fi

# A row: state, name, value, unit, target. A proof that fails makes the whole fail, a time does not.
row() {
    printf '%-4s  %-44s %12s %-6s %s\n' "$1" "$2" "$3" "$4" "${5:+(target $5)}" | tee -a "$table"
    [ "$1" != FAIL ] || failed=1
}

# Runs a command within its limit, s. Its output goes to a file, what it says into the log. A device that
# was lost on the way, or for which the CPU computed, proves nothing.
step() {
    tried "$@" && ! grep -q 'opened again\|the CPU computes' "$out/work/err"
}

# The same of tests, which try such things.
tried() {
    limit=$1 to=$2 && shift 2
    echo "+ $*" >>"$log"
    timeout "$limit" "$@" >"$to" 2>"$out/work/err"
    code=$?
    cat "$out/work/err" >>"$log"
    return $code
}

# A time beside its target, where there is one: ok, MISS or new. Without a number it failed.
time_row() {
    case $2 in
    *[0-9]*) ;;
    *) row FAIL "$1" - - && return ;;
    esac
    state=new
    [ -z "${4:-}" ] || state=$(awk -v v="$2" -v t="$4" 'BEGIN { print (v + 0 <= t + 0) ? "ok" : "MISS" }')
    [ $small = 0 ] || state=new
    row "$state" "$1" "$(awk -v v="$2" 'BEGIN { printf "%.4g", v }')" "$3" "${4:-}"
}

# The first number of a key in a file of JSON.
number() { sed 's/,"/\n"/g' "$2" | sed -n "s/.*\"$1\": *\([-0-9.e+]*\).*/\1/p" | head -n 1; }

# Milliseconds since some moment.
now_ms() { date +%s%N | cut -c 1-13; }

median() { sort -n | awk '{ v[NR] = $1 } END { print v[int((NR + 1) / 2)] }'; }

# 1. The device, by what computes there.
step 20 "$out/devices.json" "$intima" devices --json || row FAIL "devices are listed" - -
step 60 /dev/null "$intima" phantom tube --size "$ball" --mask -o "$out/work/tube.nrrd" || row FAIL "phantom" - -
step 60 "$out/work/first.json" "$intima" distance "$out/work/tube.nrrd" --threshold 0.5: --device "$device" --json -o "$out/work/d.nrrd"
name=$(sed -n 's/.*"device": *"\([^"]*\)".*/\1/p' "$out/work/first.json" | head -n 1)
[ -n "$name" ] && [ "$name" != cpu ] && row ok "device" - - || row FAIL "device" - -
echo "      $name" | tee -a "$table"

# 2. Kernels beside their twins, golden frames, plans, memory; driver life. Without a validation layer the
# tests that need one are left out; the program that they start is that of the pack.
if [ -x "$pack/gpu-tests" ]; then
    INTIMA_TEST_ROOT=$(cd "$pack/root" && pwd) && export INTIMA_TEST_ROOT
    INTIMA_TEST_PROGRAM=$(cd "$pack" && pwd)/intima && export INTIMA_TEST_PROGRAM
    tried 300 "$out/work/tests" "$pack/gpu-tests" --test-threads 8
    state=$? && cat "$out/work/tests" >>"$log"
    passed=$(grep -c '^test .* ok$' "$out/work/tests")
    [ $state = 0 ] && row ok "tests of the device" "$passed" tests || row FAIL "tests of the device" "$passed" tests
    lives=0
    for i in 1 2 3; do
        tried 60 "$out/work/tests" "$pack/gpu-tests" vulkan:: --test-threads 2 && lives=$((lives + 1))
    done
    [ $lives = 3 ] && row ok "driver life" 3 times || row FAIL "driver life" $lives "of 3"
else
    row new "tests of the device" left-out -
fi

# 3. Integer products: the same bytes as those of the CPU, twice.
for input in "$out/work/tube.nrrd" "$pack/colon.nii.gz" "$pack/airway.nii.gz"; do
    [ -f "$input" ] || continue
    base=$(basename "$input" | cut -d . -f 1)
    for product in segment distance surface; do
        ending=nrrd && [ $product != surface ] || ending=stl # without normals, which have a tolerance
        same=1
        for who in cpu "$device" "$device"; do
            file=$out/work/$product.$ending
            step 120 /dev/null "$intima" $product "$input" --threshold 0.5: --device "$who" -o "$file" || same=0
            sum=$(cksum <"$file" 2>/dev/null)
            [ "$who" != cpu ] || expected=$sum
            [ -n "$sum" ] && [ "$sum" = "$expected" ] || same=0
            rm -f "$file"
        done
        [ $same = 1 ] && row ok "$base: $product as on the CPU, twice" equal - || row FAIL "$base: $product as on the CPU, twice" differs -
    done
done

# 4. Kernels, cold and warm, and what plans ask for.
for file in "$out/work/cold.json" "$out/bench.json"; do
    step 120 "$file" "$intima" bench --size "$bench" --device "$device" --counts --json || row FAIL "bench" - -
done
time_row "device ready for the first dispatch, cold" "$(number first_dispatch_ms "$out/work/cold.json")" ms
time_row "device ready for the first dispatch" "$(number first_dispatch_ms "$out/bench.json")" ms 70
sed 's/"least".*//; s/.*"asked"//' "$out/bench.json" >"$out/work/asked"
time_row "submissions of the bench's plans" "$(number submissions "$out/work/asked")" - 9
time_row "taking results of the bench's plans" "$(number take_us "$out/work/asked")" us
repeat=5 && [ $small = 0 ] || repeat=1
step 120 "$out/work/d.json" "$intima" distance "$out/work/tube.nrrd" --threshold 0.5: --device "$device" --repeat $repeat --json -o "$out/work/d.nrrd"
time_row "distance of $ball cubed" "$(number median_s "$out/work/d.json")" s 0.008

# 5. The chain, in rounds.
input=$out/work/tube.nrrd
[ $small = 1 ] || [ ! -f "$pack/colon.nii.gz" ] || input=$pack/colon.nii.gz
i=0 && : >"$out/work/runs"
while [ $i -lt $rounds ]; do
    step 120 /dev/null "$intima" run "$input" --threshold 0.5: --device "$device" --frames $short --size 1280x720 --out "$out/work/run" || row FAIL "run" - -
    number total_ms "$out/work/run/report.json" >>"$out/work/runs" && i=$((i + 1))
done
cp "$out/work/run/report.json" "$out/report.json" 2>/dev/null
unnamed=$(awk -v u="$(number unnamed_ms "$out/report.json")" -v t="$(number total_ms "$out/report.json")" 'BEGIN { if (t > 0) print 100 * u / t }')
time_row "part of the run in no stage" "$unnamed" % 3
time_row "run with $short frames of 1280x720" "$(median <"$out/work/runs")" ms 900

# 6. Frames of every mode.
for mode in off culled auto vds; do
    : >"$out/work/times" && i=0
    while [ $i -lt $rounds ]; do
        step 120 "$out/work/f.json" "$intima" record "$input" --threshold 0.5: --device "$device" --frames $frames --size $width --lod $mode --out "$out/work/frames" --json || row FAIL "record --lod $mode" - -
        number p50_ms "$out/work/f.json" >>"$out/work/times" && i=$((i + 1))
    done
    time_row "a frame of $width, --lod $mode" "$(median <"$out/work/times")" ms
done

# 7. The window's loop without a display.
for size in 1920x1080 3840x2160; do
    [ $small = 0 ] || size=320x180
    steps="{\"wait\":\"complete\"},{\"do\":\"toggle_play\"},{\"frames\":$window},{\"picture\":\"end\"}"
    printf '{"schema":"intima.script/1","size":[%s,%s],"fps":60,"steps":[%s]}' "${size%x*}" "${size#*x}" "$steps" >"$out/work/s.json"
    sed "s/\"frames\":$window/\"frames\":1/" "$out/work/s.json" >"$out/work/s1.json"
    for script in s1 s; do
        begun=$(now_ms)
        step 120 /dev/null "$intima" fly "$input" --threshold 0.5: --device "$device" --script "$out/work/$script.json" --frames-out "$out/window-$size" || row FAIL "window $size" - -
        eval "took_$script=$(($(now_ms) - begun))"
    done
    each=$(awk -v a="$took_s" -v b="$took_s1" -v n="$window" 'BEGIN { printf "%.2f", (a - b) / (n - 1) }')
    time_row "a frame of the window, $size" "$each" ms
    [ $small = 0 ] || break
done

# 8. A device that is lost in a stage and while frames are drawn goes on; for ever, frames end with a line.
if [ -f "$pack/has-faults" ]; then
    lost() {
        fault=$1 wanted=$2 said=$3 && shift 3
        echo "+ INTIMA_FAULT=$fault $*" >>"$log"
        INTIMA_FAULT=$fault timeout 60 "$intima" "$@" --threshold 0.5: --device "$device" >>"$log" 2>"$out/work/err"
        code=$?
        cat "$out/work/err" >>"$log"
        state=ok && [ $code = "$wanted" ] && grep -q "$said" "$out/work/err" || state=FAIL
        row $state "$1, lost at $fault" "exit $code" -
    }
    lost submit:1-1 0 'opened again' distance "$out/work/tube.nrrd" -o "$out/work/lost.nrrd"
    lost submit:1 0 'the CPU computes from now on' distance "$out/work/tube.nrrd" -o "$out/work/lost.nrrd"
    lost submit:40-40 0 'draws on' record "$out/work/tube.nrrd" --frames 60 --size 160x90 --out "$out/work/lost"
    lost submit:40 1 'lost' record "$out/work/tube.nrrd" --frames 60 --size 160x90 --out "$out/work/lost"
fi

rm -rf "$out/work"
[ $failed = 0 ] && echo "accepted" | tee -a "$table" || echo "NOT accepted: see $log" | tee -a "$table"
exit $failed
