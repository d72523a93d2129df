// Lines along x hold neighbouring elements in one thread; turned, neighbouring threads hold them, so
// that a store of a workgroup is of whole sectors. All threads of a workgroup call it.

// Nine words a line: no two lines begin in the same bank.
var<workgroup> turning: array<u32, 576>;

// Eight words of a thread, as their bits.
struct Words { a: vec4<u32>, b: vec4<u32> }

// Words 8 `local` to 8 `local` + 7 of a brick in; words `local`, `local` + 64, ... out.
fn turned(words: Words, local: u32) -> Words {
    for (var i = 0u; i < 4u; i++) {
        turning[9u * local + i] = words.a[i];
        turning[9u * local + 4u + i] = words.b[i];
    }
    workgroupBarrier();
    var out: Words;
    for (var i = 0u; i < 4u; i++) {
        let a = 64u * i + local;
        let b = a + 256u;
        out.a[i] = turning[9u * (a >> 3u) + (a & 7u)];
        out.b[i] = turning[9u * (b >> 3u) + (b & 7u)];
    }
    return out;
}
