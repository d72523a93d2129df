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
rm -rf "$out" && mkdir -p "$out/work" || exit 2
table=$out/table.txt log=$out/log.txt failed=0
: >"$table"
export INTIMA_REQUIRE_GPU=1

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

# Runs a command of a step within its limit, s; what it says goes into the log.
step() {
    limit=$1 && shift
    echo "+ $*" >>"$log"
    timeout "$limit" "$@" >>"$log" 2>"$out/work/err"
    code=$?
    cat "$out/work/err" >>"$log"
    return $code
}

# A time beside its target, where there is one: ok, MISS or new.
time_row() {
    state=new
    [ -z "${4:-}" ] || state=$(awk -v v="$2" -v t="$4" 'BEGIN { print (v <= t) ? "ok" : "MISS" }')
    [ $small = 0 ] || state=new
    row "$state" "$1" "$(awk -v v="$2" 'BEGIN { printf "%.4g", v }')" "$3" "${4:-}"
}

# The first number of a key in a file of JSON.
number() { sed 's/,"/\n"/g' "$2" | sed -n "s/.*\"$1\": *\([-0-9.e+]*\).*/\1/p" | head -n 1; }

# Milliseconds since some moment.
now_ms() { date +%s%N | cut -c 1-13; }

median() { sort -n | awk '{ v[NR] = $1 } END { print v[int((NR + 1) / 2)] }'; }

# 1. The device.
step 20 "$intima" devices --json || row FAIL "devices are listed" - -
"$intima" devices --json >"$out/devices.json" 2>/dev/null
name=$(sed 's/.*"name":"\([^"]*\)".*/\1/;q' "$out/devices.json")
row ok "device" "-" "-" && echo "      $name" | tee -a "$table"

# 2. Kernels beside their twins, golden frames, plans, memory; driver life.
if [ -x "$pack/gpu-tests" ]; then
    # Golden pictures lie beside the program.
    CARGO_MANIFEST_DIR=$(cd "$pack/root" && pwd) && export CARGO_MANIFEST_DIR
    step 300 "$pack/gpu-tests" --test-threads 8
    state=$? && passed=$(grep -c '^test .* ok$' "$log")
    [ $state = 0 ] && row ok "tests of the device" "$passed" tests || row FAIL "tests of the device" "$passed" tests
    for i in 1 2 3; do
        step 60 "$pack/gpu-tests" vulkan:: --test-threads 2 || row FAIL "driver life, time $i" - -
    done
    row ok "driver life" 3 times
else
    row new "tests of the device" left-out -
fi

# 3. Integer products: the same bytes as those of the CPU, twice.
step 60 "$intima" phantom tube --size "$ball" --mask -o "$out/work/tube.nrrd" || row FAIL "phantom" - -
for input in "$out/work/tube.nrrd" "$pack"/colon.nii.gz "$pack"/airway.nii.gz; do
    [ -f "$input" ] || continue
    base=$(basename "$input" | cut -d . -f 1)
    for product in segment distance surface; do
        ending=nrrd && [ $product != surface ] || ending=stl # without normals, which have a tolerance
        same=1
        for who in cpu "$device" "$device"; do
            file=$out/work/$product-$who.$ending
            step 120 "$intima" $product "$input" --threshold 0.5: --device "$who" -o "$file" || same=0
            sum=$(cksum <"$file" 2>/dev/null)
            [ "$who" != cpu ] || expected=$sum
            [ "$sum" = "$expected" ] || same=0
            rm -f "$file"
        done
        [ $same = 1 ] && row ok "$base: $product as on the CPU, twice" equal - || row FAIL "$base: $product as on the CPU, twice" differs -
    done
done

# 4. Kernels, warm and cold, and what plans ask for.
step 120 "$intima" bench --size "$bench" --device "$device" --counts --json
"$intima" bench --size "$bench" --device "$device" --counts --json >"$out/bench.json" 2>>"$log" || row FAIL "bench" - -
time_row "device ready for the first dispatch" "$(number first_dispatch_ms "$out/bench.json")" ms 70
asked=$(sed 's/"least".*//; s/.*"asked"//' "$out/bench.json" >"$out/work/asked" && number submissions "$out/work/asked")
time_row "submissions of eight plans" "$asked" - 9
time_row "taking results of eight plans" "$(number take_us "$out/work/asked")" us
repeat=5 && [ $small = 0 ] || repeat=1
"$intima" distance "$out/work/tube.nrrd" --threshold 0.5: --device "$device" --repeat $repeat --json -o "$out/work/d.nrrd" >"$out/work/d.json" 2>>"$log"
time_row "distance of $ball cubed" "$(number median_s "$out/work/d.json")" s 0.008

# 5. The chain, in rounds.
input=$out/work/tube.nrrd && [ $small = 1 ] || [ ! -f "$pack/colon.nii.gz" ] || input=$pack/colon.nii.gz
i=0 && : >"$out/work/runs"
while [ $i -lt $rounds ]; do
    step 120 "$intima" run "$input" --threshold 0.5: --device "$device" --frames $short --size 1280x720 --out "$out/work/run" || row FAIL "run" - -
    number total_ms "$out/work/run/report.json" >>"$out/work/runs" && i=$((i + 1))
done
cp "$out/work/run/report.json" "$out/report.json" 2>/dev/null
unnamed=$(awk -v u="$(number unnamed_ms "$out/report.json")" -v t="$(number total_ms "$out/report.json")" 'BEGIN { print 100 * u / t }')
time_row "part of the run in no stage" "$unnamed" % 3
time_row "run with $short frames of 1280x720" "$(median <"$out/work/runs")" ms 900

# 6. Frames of every mode.
for mode in off culled auto vds; do
    : >"$out/work/times" && i=0
    while [ $i -lt $rounds ]; do
        "$intima" record "$input" --threshold 0.5: --frames $frames --size $width --lod $mode --out "$out/work/frames" --json >"$out/work/f.json" 2>>"$log" || row FAIL "record --lod $mode" - -
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
        step 120 "$intima" fly "$input" --threshold 0.5: --script "$out/work/$script.json" --frames-out "$out/window-$size" || row FAIL "window $size" - -
        eval "took_$script=$(($(now_ms) - begun))"
    done
    each=$(awk -v a="$took_s" -v b="$took_s1" -v n="$window" 'BEGIN { printf "%.2f", (a - b) / (n - 1) }')
    time_row "a frame of the window, $size" "$each" ms
    [ $small = 0 ] || break
done

# 8. A device that is lost in a stage and in a frame.
if [ -f "$pack/has-faults" ]; then
    # Says which: goes on, or ends with one line and a code of its own.
    lost() {
        echo "+ INTIMA_FAULT=$1 $2" >>"$log"
        INTIMA_FAULT=$1 timeout 60 "$intima" "$2" "$out/work/tube.nrrd" --threshold 0.5: --device "$device" $3 >>"$log" 2>&1
        code=$?
        state=ok && [ $code -le 1 ] || state=FAIL
        said="goes on" && [ $code = 0 ] || said="ends"
        row $state "$2, lost at $1" "$said" "$code"
    }
    lost submit:1-1 distance "-o $out/work/lost.nrrd"
    lost submit:1 distance "-o $out/work/lost.nrrd"
    lost submit:40 record "--frames 60 --size 160x90 --out $out/work/lost"
fi

rm -rf "$out/work"
[ $failed = 0 ] && echo "accepted" | tee -a "$table" || echo "NOT accepted: see $log" | tee -a "$table"
exit $failed
