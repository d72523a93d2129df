//! Damaged and lying files: one line of error, no panic, no memory taken on a header's word.

use std::io::Write;
use std::path::Path;
use std::sync::OnceLock;

use common::volumes::{self, NiftiHeader, dicom_slice, phantom};
use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use intima::formats::{
    FormatError, ReadOptions, inspect, read_mesh, read_volume, write_mesh, write_volume,
};
use proptest::prelude::*;

fn read(path: &Path) -> Result<(), FormatError> {
    read_volume(path, &ReadOptions::default()).map(|_| ())
}

/// The error of a file of these bytes: one line that names the file.
fn refusal(name: &str, bytes: &[u8]) -> String {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    let error = read(&path).expect_err("must be refused");
    assert!(error.is_bad_input(), "{error}");
    let text = error.to_string();
    println!("{text}");
    assert!(!text.contains('\n') && text.contains(name), "{text}");
    text
}

/// Largest resident memory of this process so far, KiB; 0 where the system does not say.
fn peak_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    line.and_then(|l| l.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::best());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

fn nrrd(fields: &str, data: &[u8]) -> Vec<u8> {
    let mut file = format!("NRRD0004\n{fields}\n\n").into_bytes();
    file.extend(data);
    file
}

#[test]
fn a_20_kb_file_that_claims_100_gb_is_refused() {
    let before = peak_kib();
    let junk = vec![7u8; 20_000];
    // 3000^3 floats are 108 GB.
    for encoding in ["raw", "gzip", "ascii"] {
        let head = format!(
            "type: float\ndimension: 3\nsizes: 3000 3000 3000\nspacings: 1 1 1\nendian: little\n\
             encoding: {encoding}"
        );
        assert!(refusal("big.nrrd", &nrrd(&head, &junk)).contains("108000000000"));
    }
    for packed in ["True", "False"] {
        let mut mha = format!(
            "NDims = 3\nDimSize = 3000 3000 3000\nElementType = MET_FLOAT\n\
             CompressedData = {packed}\nElementSpacing = 1 1 1\nElementDataFile = LOCAL\n"
        )
        .into_bytes();
        mha.extend(&junk);
        assert!(refusal("big.mha", &mha).contains("108000000000"));
    }
    let mut nii = NiftiHeader { code: 16, ..NiftiHeader::default() }.bytes();
    for at in [42, 44, 46] {
        nii[at..at + 2].copy_from_slice(&3000i16.to_le_bytes());
    }
    nii.extend(&junk);
    assert!(refusal("big.nii", &nii).contains("108000000000"));
    assert!(refusal("big.nii.gz", &gzip(&nii)).contains("108000000000"));
    let mut slice = dicom_slice(&volumes::Slice::default());
    let rows = find(&slice, &[0x28, 0, 0x10, 0, b'U', b'S', 2, 0]) + 8;
    slice[rows..rows + 2].copy_from_slice(&60000u16.to_le_bytes());
    slice[rows + 10..rows + 12].copy_from_slice(&60000u16.to_le_bytes());
    assert!(refusal("big.dcm", &slice).contains("7200000000 bytes of pixels"));
    // Tests beside this one take some; a claim believed would take gigabytes.
    assert!(peak_kib() < before + 400_000, "{} KiB", peak_kib());
}

fn find(bytes: &[u8], what: &[u8]) -> usize {
    bytes.windows(what.len()).position(|w| w == what).expect("in the file")
}

#[test]
fn dimensions_beyond_all_bounds_are_named() {
    let fields = |sizes: &str| {
        format!("type: uint8\ndimension: 3\nsizes: {sizes}\nspacings: 1 1 1\nencoding: raw")
    };
    for sizes in ["0 1 1", "40000 1 1", "18446744073709551615 2 2", "30000 30000 30000"] {
        let text = refusal("d.nrrd", &nrrd(&fields(sizes), b"xx"));
        assert!(text.contains("dimensions"), "{text}");
    }
    for sizes in ["-1 1 1", "1 1", "1e3 1 1", "99999999999999999999 1 1"] {
        let text = refusal("d.nrrd", &nrrd(&fields(sizes), b"xx"));
        assert!(text.contains("sizes: expected 3 numbers"), "{text}");
    }
    let mut nii = NiftiHeader { code: 2, ..NiftiHeader::default() }.bytes();
    nii[42..44].copy_from_slice(&(-2i16).to_le_bytes());
    assert!(refusal("d.nii", &nii).contains("65534"));
}

#[test]
fn nan_spacing_is_named() {
    let data = [0u8; 8];
    for (spacings, what) in [("nan 1 1", "NaN"), ("0 1 1", "0.0"), ("inf 1 1", "inf")] {
        let head =
            format!("type: uint8\ndimension: 3\nsizes: 2 2 2\nspacings: {spacings}\nencoding: raw");
        let text = refusal("s.nrrd", &nrrd(&head, &data));
        assert!(text.contains("spacing") && text.contains(what), "{text}");
        let mut mha = format!(
            "NDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\nElementSpacing = {spacings}\n\
             ElementDataFile = LOCAL\n"
        )
        .into_bytes();
        mha.extend(data);
        assert!(refusal("s.mha", &mha).contains(what));
    }
    for bad in [f32::NAN, 0.0, -1.0] {
        let h = NiftiHeader { code: 2, pixdim: [bad, 1.0, 1.0], ..NiftiHeader::default() };
        let mut nii = h.bytes();
        nii.extend([0; 24]);
        assert!(refusal("s.nii", &nii).contains("spacing"));
    }
    let bad = volumes::Slice { pixel_spacing: "0\\1", ..volumes::Slice::default() };
    assert!(refusal("s.dcm", &dicom_slice(&bad)).contains("PixelSpacing is `0 1`"));
}

#[test]
fn a_direction_that_does_not_span_space_is_named() {
    let head = "type: uint8\ndimension: 3\nsizes: 2 2 2\nspace: LPS\nencoding: raw\n\
                space directions: (1,0,0) (1,0,0) (0,0,1)";
    assert!(refusal("f.nrrd", &nrrd(head, &[0; 8])).contains("do not span space"));
    let head = "type: uint8\ndimension: 3\nsizes: 2 2 2\nspace: LPS\nencoding: raw\n\
                space directions: (1,0,0) (1,0) (0,0,1)";
    assert!(refusal("f.nrrd", &nrrd(head, &[0; 8])).contains("expected vectors"));
}

#[test]
fn unknown_types_and_encodings_are_named() {
    let head = |kind: &str, encoding: &str| {
        format!(
            "type: {kind}\ndimension: 3\nsizes: 2 2 2\nspacings: 1 1 1\nencoding: {encoding}\n\
             endian: little"
        )
    };
    assert!(
        refusal("t.nrrd", &nrrd(&head("quad", "raw"), &[]))
            .contains("type: not a NRRD sample type")
    );
    assert!(refusal("t.nrrd", &nrrd(&head("block", "raw"), &[])).contains("block"));
    assert!(refusal("t.nrrd", &nrrd(&head("short", "bzip2"), &[])).contains("bzip2"));
    assert!(
        refusal("t.nrrd", &nrrd(&head("short", "lzma"), &[]))
            .contains("encoding: not a NRRD encoding")
    );
    let h = NiftiHeader { code: 77, ..NiftiHeader::default() };
    assert!(refusal("t.nii", &h.bytes()).contains("datatype is `77`"));
    for (code, name) in [(1536, "128-bit"), (128, "RGB"), (32, "complex"), (1, "binary")] {
        let h = NiftiHeader { code, ..NiftiHeader::default() };
        assert!(refusal("t.nii", &h.bytes()).contains(name));
    }
    let mha = b"NDims = 3\nDimSize = 2 2 2\nElementType = MET_OTHER\nElementDataFile = LOCAL\n";
    assert!(refusal("t.mha", mha).contains("ElementType: not a MetaImage"));
    let mut nifti2 = vec![0; 600];
    nifti2[..4].copy_from_slice(&540i32.to_le_bytes());
    assert!(refusal("t.nii", &nifti2).contains("NIfTI-2"));
}

#[test]
fn truncated_gzip_is_named() {
    let mut nii = NiftiHeader::default().bytes();
    nii.extend((0..48u8).map(|v| v.wrapping_mul(101)));
    let whole = gzip(&nii);
    let noise: Vec<u8> =
        (0..4096u32).map(|v| (v.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    let head = "type: uint8\ndimension: 3\nsizes: 16 16 16\nspacings: 1 1 1\nencoding: gzip";
    let packed = gzip(&noise);
    for keep in [packed.len() / 2, packed.len() - 9, packed.len() - 4] {
        let text = refusal("g.nrrd", &nrrd(head, &packed[..keep]));
        assert!(text.contains("truncated"), "{keep}: {text}");
    }
    assert!(refusal("g.nii.gz", &whole[..whole.len() - 20]).contains("truncated"));
    assert!(refusal("g.nii.gz", &whole[..30]).contains("header"));
    let mut wrong = packed.clone();
    let crc = wrong.len() - 6;
    wrong[crc] ^= 1;
    assert!(refusal("g.nrrd", &nrrd(head, &wrong)).contains("sample data"));
    let mut zlib = ZlibEncoder::new(Vec::new(), Compression::fast());
    zlib.write_all(&noise).unwrap();
    let zlib = zlib.finish().unwrap();
    let mha = |data: &[u8]| {
        let mut file = b"NDims = 3\nDimSize = 16 16 16\nElementType = MET_UCHAR\n\
                         CompressedData = True\nElementSpacing = 1 1 1\nElementDataFile = LOCAL\n"
            .to_vec();
        file.extend(data);
        file
    };
    assert!(refusal("g.mha", &mha(&zlib[..zlib.len() / 2])).contains("truncated"));
    assert!(refusal("g.mha", &mha(b"not zlib at all")).contains("sample data"));
}

#[test]
fn truncated_raw_samples_are_counted() {
    let head = "type: uint8\ndimension: 3\nsizes: 4 4 4\nspacings: 1 1 1\nencoding: raw";
    assert!(refusal("r.nrrd", &nrrd(head, &[0; 63])).contains("promises 64 bytes"));
    let head = format!("{head}\nline skip: 9");
    assert!(refusal("r.nrrd", &nrrd(&head, &[0; 64])).contains("line skip is `9`"));
    let mut slice = dicom_slice(&volumes::Slice::default());
    slice.truncate(slice.len() - 4);
    assert!(refusal("r.dcm", &slice).contains("truncated"));
}

#[test]
fn a_dicom_element_that_claims_4_gb_takes_no_memory() {
    let before = peak_kib();
    for vr in [b"OB", b"UN", b"UT", b"SQ", b"ZZ"] {
        let mut slice = dicom_slice(&volumes::Slice::default());
        let at = find(&slice, b"\x20\0\x0e\0UI");
        let mut element = b"\x18\0\x18\x90".to_vec();
        element.extend(vr);
        element.extend([0, 0]);
        element.extend(0xffff_fff0u32.to_le_bytes());
        slice.splice(at..at, element);
        assert!(refusal("e.dcm", &slice).contains("truncated"));
    }
    assert!(peak_kib() < before + 400_000);
}

#[test]
fn dicom_sequences_nested_without_end_are_refused() {
    let mut slice = dicom_slice(&volumes::Slice::default());
    let at = find(&slice, b"\x20\0\x0e\0UI");
    let mut nest = Vec::new();
    for _ in 0..100_000 {
        nest.extend(b"\x08\0\x40\x11SQ\0\0\xff\xff\xff\xff\xfe\xff\0\xe0\xff\xff\xff\xff");
    }
    slice.splice(at..at, nest);
    assert!(refusal("n.dcm", &slice).contains("nested deeper"));
}

/// A small valid file of each format.
fn samples() -> &'static [(&'static str, Vec<u8>)] {
    static FILES: OnceLock<Vec<(&str, Vec<u8>)>> = OnceLock::new();
    FILES.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let mut files = Vec::new();
        for name in ["a.nrrd", "a.nii", "a.nii.gz", "a.mha"] {
            let path = dir.path().join(name);
            write_volume(&path, &phantom(true)).unwrap();
            files.push((name, std::fs::read(&path).unwrap()));
        }
        let head = "type: short\ndimension: 3\nsizes: 2 2 2\nspace: RAS\nencoding: ascii\n\
                    space directions: (1,0,0) (0,1,0) (0,0,1)";
        files.push(("b.nrrd", nrrd(head, b"1 2 3 4 5 6 7 8\n")));
        files.push(("a.dcm", dicom_slice(&volumes::Slice::default())));
        let implicit = volumes::Slice { implicit: true, ..volumes::Slice::default() };
        files.push(("b.dcm", dicom_slice(&implicit)));
        files
    })
}

/// Small valid meshes, their headers text.
fn meshes() -> Vec<(&'static str, Vec<u8>)> {
    let mesh = intima::geometry::Mesh {
        positions: vec![[0.0, 0.0, 0.0].into(), [1.0, 0.0, 0.0].into(), [0.0, 1.0, 0.0].into()],
        faces: vec![[0, 1, 2]],
        ..Default::default()
    };
    let dir = tempfile::tempdir().unwrap();
    let mut files = Vec::new();
    for name in ["m.ply", "m.stl", "m.obj", "m.vtp"] {
        let path = dir.path().join(name);
        write_mesh(&path, &mesh).unwrap();
        files.push((name, std::fs::read(&path).unwrap()));
    }
    let text = "solid a SPACE=LPS\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n\
                vertex 0 1 0\nendloop\nendfacet\nendsolid a\n";
    files.push(("t.stl", text.into()));
    let text = "ply\nformat ascii 1.0\ncomment SPACE=LPS\nelement vertex 3\nproperty float x\n\
                property float y\nproperty float z\nelement face 1\n\
                property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    files.push(("t.ply", text.into()));
    files
}

/// Every token of the header, and every eight bytes of it, are replaced by a name in turn: what is
/// said of the file never holds the name.
#[test]
fn no_refusal_repeats_text_of_a_header() {
    const NAME: &[u8] = b"JANE^DOE";
    let dir = common::scratch();
    let (mut read_well, mut refused) = (0, 0);
    let mut files: Vec<_> = samples().to_vec();
    files.extend(meshes());
    let mhd = "NDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\nElementSpacing = 1 1 1\n\
               DistanceUnits = mm\nElementDataFile = raw.raw\n";
    files.push(("d.mhd", mhd.into()));
    let nhdr = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nspacings: 1 1 1\n\
                encoding: raw\ndata file: raw.raw\n\n";
    files.push(("d.nhdr", nhdr.into()));
    std::fs::write(dir.path().join("raw.raw"), [0; 8]).unwrap();
    for (name, bytes) in &files {
        let path = dir.path().join(name);
        let head = bytes.len().min(1500);
        let is_token = |b: u8| b.is_ascii_alphanumeric() || b"+-._".contains(&b);
        let mut spans: Vec<(usize, usize)> = (0..head).map(|at| (at, at + NAME.len())).collect();
        let mut at = 0;
        while at < head {
            let len = bytes[at..head].iter().take_while(|b| is_token(**b)).count();
            if len > 0 {
                spans.push((at, at + len));
            }
            at += len + 1;
        }
        for (from, to) in spans {
            let tail = &bytes[to.min(bytes.len())..];
            std::fs::write(&path, [&bytes[..from], NAME, tail].concat()).unwrap();
            let mesh = ["ply", "stl", "obj", "vtp"].iter().any(|e| name.ends_with(e));
            let said = match mesh {
                true => read_mesh(&path, None).map(|(_, warnings)| warnings.join(" ")),
                false => read_volume(&path, &ReadOptions::default()).map(|_| String::new()),
            };
            read_well += usize::from(said.is_ok());
            refused += usize::from(said.is_err());
            let said = said.unwrap_or_else(|e| format!("{e} {e:?}"));
            assert!(!said.contains("JANE"), "{name}, bytes {from}..{to}: {said}");
            let info = inspect(&path, &ReadOptions::default());
            let info = info.map_or_else(|e| e.to_string(), |i| format!("{i:?}"));
            assert!(!info.contains("JANE"), "{name}, bytes {from}..{to}: {info}");
        }
    }
    println!("{refused} refused, {read_well} read");
    assert!(refused > 2000 && read_well > 500, "{refused} {read_well}");
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 20_000,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn flipped_bytes_and_cuts_never_panic(
        which in 0usize..7,
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in prop::option::weighted(0.4, any::<prop::sample::Index>()),
        head_only in any::<bool>(),
    ) {
        let (name, bytes) = &samples()[which];
        let mut bytes = bytes.clone();
        for (at, value) in flips {
            let len = if head_only { bytes.len().min(400) } else { bytes.len() };
            bytes[at.index(len)] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        let dir = common::scratch();
        let path = dir.path().join(name);
        std::fs::write(&path, &bytes).unwrap();
        let before = peak_kib();
        if let Err(e) = read(&path) {
            prop_assert!(!e.to_string().contains('\n'), "{}", e);
        }
        let _ = inspect(&path, &ReadOptions::default());
        prop_assert!(peak_kib() < before + 400_000, "{} {}", before, peak_kib());
    }
}

/// Six links to itself at each of eight depths would be 1.7 million folders.
#[cfg(unix)]
#[test]
fn a_folder_of_links_to_itself_is_searched_once() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    for (n, position) in [[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]].into_iter().enumerate() {
        let slice = volumes::Slice { position, ..volumes::Slice::default() };
        std::fs::write(at(&n.to_string()), dicom_slice(&slice)).unwrap();
    }
    for n in 0..6 {
        std::os::unix::fs::symlink(".", at(&format!("link{n}"))).unwrap();
    }
    std::os::unix::fs::symlink(dir.path(), at("whole")).unwrap();
    let began = std::time::Instant::now();
    let info = inspect(dir.path(), &ReadOptions::default()).unwrap();
    println!("{:.3} s, {:?}", began.elapsed().as_secs_f64(), info.notes);
    assert_eq!(info.image.unwrap().dims[2], 2);
    assert!(info.notes.is_empty(), "{:?}", info.notes);
    assert!(began.elapsed().as_secs() < 10);
}

#[cfg(unix)]
#[test]
fn a_header_does_not_follow_a_link_out_of_its_folder() {
    let dir = tempfile::tempdir().unwrap();
    let inner = dir.path().join("inner");
    std::fs::create_dir(&inner).unwrap();
    let outside = dir.path().join("secret.raw");
    std::fs::write(&outside, [7; 8]).unwrap();
    let nhdr = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nspacings: 1 1 1\n\
                encoding: raw\ndata file: d.raw\n\n";
    let mhd = "NDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\nElementSpacing = 1 1 1\n\
               ElementDataFile = d.raw\n";
    for (name, header) in [("a.nhdr", nhdr), ("a.mhd", mhd)] {
        let header_path = inner.join(name);
        std::fs::write(&header_path, header).unwrap();
        let data = inner.join("d.raw");
        for to in [outside.as_path(), Path::new("../secret.raw")] {
            std::os::unix::fs::symlink(to, &data).unwrap();
            let said = read(&header_path).unwrap_err().to_string();
            assert!(said.contains("link out of the header's folder"), "{said}");
            std::fs::remove_file(&data).unwrap();
        }
        // Within the folder links are followed.
        std::fs::write(inner.join("real.raw"), [7; 8]).unwrap();
        std::os::unix::fs::symlink("real.raw", &data).unwrap();
        read(&header_path).unwrap();
        std::fs::remove_file(&data).unwrap();
    }
}
