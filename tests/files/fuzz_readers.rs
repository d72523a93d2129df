//! Every reader on mutated files: a fixed sequence of random damage to one small file of each
//! format. Whatever comes, a reader answers with a result or one line of error, does not panic, and
//! takes little memory for what it refuses. `INTIMA_FUZZ_ROUNDS` sets how many mutants of each file
//! are tried; the default takes some ten seconds in all.

use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use crate::COUNTED;
use common::child;
use common::readers::read;
use common::volumes;
use intima::formats::{write_mesh, write_volume};
use intima::geometry::Mesh;

/// Mutants of each file.
const ROUNDS: u64 = 500;
/// A slice in each compressed syntax.
const CODECS: [&str; 6] =
    ["jpeg_8.dcm", "jpeg_12.dcm", "jpeg_lossless.dcm", "jpeg_ls.dcm", "jpeg_2000.dcm", "htj2k.dcm"];
/// Numbers that sit at the edge of something.
const EDGES: [u64; 12] = [
    0,
    1,
    0x7f,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0xffff_ffff,
    0x1_0000_0000,
    0x7fff_ffff_ffff_ffff,
    0x7ff0_0000_0000_0000, // an infinite double
    u64::MAX,
];
/// The same as text.
const WORDS: [&str; 12] = [
    "0",
    "-1",
    "3",
    "1e9",
    "65536",
    "4294967295",
    "4294967296",
    "18446744073709551616",
    "1e309",
    "nan",
    "-inf",
    "",
];

/// A sequence of random numbers (Marsaglia, xorshift, 2003, doi:10.18637/jss.v008.i14).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// A number below `n`, or 0.
    fn below(&mut self, n: usize) -> usize {
        (self.next() >> 11) as usize % n.max(1)
    }
}

/// One to six changes, half of them where a header would be.
fn mutated(seed: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..=random.below(6) {
        let reach = if random.below(2) == 0 { bytes.len().min(400) } else { bytes.len() };
        let at = random.below(reach);
        let len = random.below(32).min(bytes.len() - at);
        match random.below(8) {
            0 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            1 if at < bytes.len() => bytes[at] = random.next() as u8,
            2 => {
                let value = EDGES[random.below(EDGES.len())];
                let width = [1, 2, 4, 8][random.below(4)].min(bytes.len() - at);
                let mut stored = value.to_le_bytes();
                if random.below(2) == 0 {
                    stored[..width].reverse();
                }
                bytes[at..at + width].copy_from_slice(&stored[..width]);
            }
            3 => {
                // The next number of the text becomes another.
                let digit = |b: &u8| b.is_ascii_digit() || b"+-.".contains(b);
                let from = at + bytes[at..].iter().take_while(|b| !digit(b)).count();
                let to = from + bytes[from..].iter().take_while(|b| digit(b)).count();
                let word = WORDS[random.below(WORDS.len())];
                bytes.splice(from..to, word.bytes());
            }
            4 => drop(bytes.drain(at..at + len)),
            5 => {
                let again = bytes[at..at + len].repeat(1 + random.below(40));
                bytes.splice(at..at, again);
            }
            6 => {
                let from = random.below(bytes.len());
                let other = bytes[from..bytes.len().min(from + len)].to_vec();
                bytes.splice(at..at, other);
            }
            _ if random.below(4) == 0 => bytes.truncate(at),
            _ => {}
        }
    }
    bytes
}

/// One small file of each format and encoding.
fn seeds() -> Vec<(&'static str, Vec<u8>)> {
    let dir = tempfile::tempdir().unwrap();
    let mut seeds = Vec::new();
    for name in ["a.nrrd", "a.nii", "a.nii.gz", "a.mha"] {
        write_volume(&dir.path().join(name), &volumes::phantom(true)).unwrap();
        seeds.push((name, std::fs::read(dir.path().join(name)).unwrap()));
    }
    let text = "NRRD0004\ntype: short\ndimension: 3\nsizes: 2 2 2\nspace: RAS\nencoding: ascii\n\
                space directions: (1,0,0) (0,1,0) (0,0,1)\n\n1 2 3 4 5 6 7 8\n";
    seeds.push(("text.nrrd", text.into()));
    let text = "NDims = 3\nDimSize = 2 2 2\nElementType = MET_SHORT\nElementSpacing = 1 1 2\n\
                BinaryData = False\nTransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 1 2 3\n\
                ElementDataFile = LOCAL\n1 2 3 4 5 6 7 8\n";
    seeds.push(("text.mha", text.into()));
    seeds.push(("a.dcm", volumes::dicom_slice(&volumes::Slice::default())));
    let implicit = volumes::Slice { implicit: true, ..volumes::Slice::default() };
    seeds.push(("b.dcm", volumes::dicom_slice(&implicit)));
    let fixture = |name: &str| std::fs::read(volumes::fixture(name)).unwrap();
    seeds.push(("layers.nrrd", fixture("seg/layers.seg.nrrd")));
    for name in ["binary.dcm", "fractional.dcm", "labels.dcm"] {
        seeds.push((name, fixture(&format!("seg/{name}"))));
    }
    let built = |name: &&str| *name != "jpeg_12.dcm" || cfg!(feature = "jpeg-12");
    for name in CODECS.into_iter().filter(built) {
        seeds.push((name, fixture(&format!("codec/{name}"))));
    }
    let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mesh = Mesh {
        positions: corners.map(Into::into).to_vec(),
        normals: vec![[0.0, 0.0, 1.0].into(); 4],
        faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        caps: vec![true, false, false, false],
    };
    for name in ["m.ply", "m.stl", "m.obj", "m.vtp"] {
        write_mesh(&dir.path().join(name), &mesh).unwrap();
        seeds.push((name, std::fs::read(dir.path().join(name)).unwrap()));
    }
    for name in ["as_vtk_writes.vtp", "inline_blocks.vtp", "text.vtp", "strips.vtp"] {
        seeds.push((name, fixture(&format!("vtp/{name}"))));
    }
    let text = "ply\nformat ascii 1.0\ncomment SPACE=LPS\nelement vertex 3\nproperty float x\n\
                property float y\nproperty float z\nelement face 1\n\
                property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    seeds.push(("text.ply", text.into()));
    let text = "solid a SPACE=LPS\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n\
                vertex 0 1 0\nendloop\nendfacet\nendsolid a\n";
    seeds.push(("text.stl", text.into()));
    let text = "{\"schema\":\"intima.path/1\",\"space\":\"LPS\",\"unit\":\"mm\",\"fov_y_deg\":77,\
                \"poses\":[\n{\"seconds\":0,\"position\":[1,2,3],\"quaternion\":[0,0,0,1],\
                \"near\":1},\n{\"seconds\":1,\"position\":[2,2,3],\"quaternion\":[0,1,0,0],\
                \"near\":0.5}]}";
    seeds.push(("path.json", text.into()));
    seeds
}

/// Reads a file: the memory taken for one that is refused, or what is wrong with how it went.
fn judged(path: &Path, bytes: &[u8]) -> Result<Option<usize>, String> {
    let before = COUNTED.current_usage();
    COUNTED.reset_peak_usage();
    let outcome = catch_unwind(AssertUnwindSafe(|| read(path, bytes)));
    let taken = COUNTED.peak_usage().saturating_sub(before);
    match outcome {
        Ok(Ok(())) => Ok(None),
        Ok(Err(e)) if e.contains('\n') => Err(format!("more than a line: {e}")),
        Ok(Err(_)) if taken > 4 * bytes.len() + 8_000_000 => {
            Err(format!("{taken} bytes of memory"))
        }
        Ok(Err(_)) => Ok(Some(taken)),
        Err(_) => Err("panicked".to_owned()),
    }
}

/// Inputs that coverage-guided fuzzing found to be of interest (`fuzz/corpus.tar.gz`, a folder for each
/// extension). `INTIMA_BLESS=1` writes the small files that mutation starts from into `fuzz/corpus`.
#[test]
fn every_file_of_the_fuzz_corpus_is_read_or_refused_in_one_line_with_little_memory() {
    if !child::alone(
        "fuzz_readers::every_file_of_the_fuzz_corpus_is_read_or_refused_in_one_line_with_little_memory",
    ) {
        return;
    }
    if std::env::var("INTIMA_BLESS").is_ok_and(|v| v == "1") {
        for (name, bytes) in seeds() {
            let extension = name.split_once('.').unwrap().1.replace('.', "_");
            let reader = common::root().join("fuzz/corpus").join(extension);
            std::fs::create_dir_all(&reader).unwrap();
            std::fs::write(reader.join(blake3::hash(&bytes).to_hex().as_str()), &bytes).unwrap();
        }
    }
    let dir = common::scratch();
    let (mut well, mut refused) = (0, 0);
    let packed = std::fs::File::open(common::root().join("fuzz/corpus.tar.gz")).unwrap();
    for file in tar::Archive::new(flate2::read::GzDecoder::new(packed)).entries().unwrap() {
        let mut file = file.unwrap();
        if !file.header().entry_type().is_file() {
            continue;
        }
        let name = file.path().unwrap().into_owned();
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).unwrap();
        let reader = name.parent().and_then(Path::file_name).unwrap();
        let extension = reader.to_string_lossy().replace('_', ".");
        let path = dir.path().join("a").with_extension(extension);
        std::fs::write(&path, &bytes).unwrap();
        match judged(&path, &bytes) {
            Ok(None) => well += 1,
            Ok(Some(_)) => refused += 1,
            Err(fault) => panic!("{}: {fault}", name.display()),
        }
    }
    println!("{well} read, {refused} refused");
    assert!(well >= 10 && refused > 100, "{well} read, {refused} refused");
}

#[test]
fn mutated_files_are_read_or_refused_in_one_line_with_little_memory() {
    if !child::alone(
        "fuzz_readers::mutated_files_are_read_or_refused_in_one_line_with_little_memory",
    ) {
        return;
    }
    let rounds = std::env::var("INTIMA_FUZZ_ROUNDS").ok().and_then(|n| n.parse().ok());
    let dir = common::scratch();
    for (name, seed) in seeds() {
        let path = dir.path().join(name);
        let mut random = Random(0x9e37_79b9_7f4a_7c15);
        let (mut well, mut refused, mut most) = (0, 0, 0);
        std::fs::write(&path, &seed).unwrap();
        read(&path, &seed).unwrap_or_else(|e| panic!("{name} as it is: {e}"));
        for round in 0..rounds.unwrap_or(ROUNDS) {
            let bytes = mutated(&seed, &mut random);
            std::fs::write(&path, &bytes).unwrap();
            match judged(&path, &bytes) {
                Ok(None) => well += 1,
                Ok(Some(taken)) => (refused, most) = (refused + 1, most.max(taken)),
                Err(fault) => {
                    let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("fuzz-{name}"));
                    std::fs::write(&kept, &bytes).unwrap();
                    panic!("{name}, round {round}: {fault}; kept as {}", kept.display());
                }
            }
        }
        println!("{name}: {well} read, {refused} refused, {most} bytes at most");
        assert!(well > 0 && refused > 0, "{name}: the damage tries nothing");
    }
}
