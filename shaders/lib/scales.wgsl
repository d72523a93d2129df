// Normals of a vertex at six scales, finest first, and what each band between two of them holds
// that half of the next coarser one does not foretell.
struct Ladder { n: array<vec3<f32>, 6> }
struct Bands { r: array<vec3<f32>, 5> }

fn ladder(v: u32, vertices: u32) -> Ladder {
    var out: Ladder;
    let raw = vec3(normal[3u * v], normal[3u * v + 1u], normal[3u * v + 2u]);
    out.n[0] = raw;
    for (var l = 0u; l < 5u; l++) {
        let u = level[l * vertices + v].xyz;
        let len = length(u);
        out.n[l + 1u] = select(raw, u / len, len >= 1e-12);
    }
    return out;
}

// Share of the coarser band foretold in the next finer one. The error of a smoothed normal grows
// with t; times double from scale to scale, so a band is half of the next one, and the finest,
// which reaches down to t = 0, all of it.
fn share(band: u32) -> f32 { return select(0.5, 1.0, band == 0u); }

fn bands(all: Ladder) -> Bands {
    var out: Bands;
    for (var k = 0u; k < 5u; k++) { out.r[k] = all.n[k] - all.n[k + 1u]; }
    for (var k = 0u; k < 4u; k++) {
        out.r[k] -= share(k) * (all.n[k + 1u] - all.n[k + 2u]);
    }
    return out;
}
