//! Memory that readers take for files they refuse, counted by the allocator: at most four times the
//! file and 8 MB, whatever a header claims.

use std::io::Write;
use std::path::Path;

use crate::COUNTED;
use common::child;
use common::volumes::{self, NiftiHeader, dicom_slice};
use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use intima::flight::CameraPath;
use intima::formats::{ReadOptions, inspect, read_mesh, read_volume};

/// Buffers of a reader and its decoder, whatever the file's size.
const FIXED: usize = 8_000_000;

/// Bytes that `f` had allocated at most, beyond those allocated before it.
fn peak<T>(f: impl FnOnce() -> T) -> (usize, T) {
    let before = COUNTED.current_usage();
    COUNTED.reset_peak_usage();
    let out = f();
    (COUNTED.peak_usage() - before, out)
}

fn assert_small(what: &str, peak: usize, size: usize) {
    println!("{what}: {peak} bytes for a file of {size}");
    assert!(peak <= 4 * size + FIXED, "{what}: {peak} bytes for a file of {size}");
}

/// A file of these bytes is refused, by the reader of its extension and by `info`.
fn refuses(name: &str, what: &str, bytes: &[u8]) -> String {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    refuses_path(&path, what, bytes.len())
}

fn refuses_path(path: &Path, what: &str, size: usize) -> String {
    let mesh = ["ply", "stl", "obj", "vtp"];
    let is_mesh = path.extension().is_some_and(|e| mesh.iter().any(|m| e == *m));
    let (taken, read) = peak(|| match is_mesh {
        true => read_mesh(path, None).map(|_| ()),
        false => read_volume(path, &ReadOptions::default()).map(|_| ()),
    });
    let what = format!("{} {what}", path.file_name().unwrap().to_string_lossy());
    let error = read.expect_err(&what);
    assert_small(&format!("{what} ({error})"), taken, size);
    if !is_mesh {
        let (taken, _) = peak(|| inspect(path, &ReadOptions::default()).map(|_| ()));
        assert_small(&format!("{what}, info"), taken, size);
    }
    error.to_string()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut out = ZlibEncoder::new(Vec::new(), Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

/// Bytes that do not compress.
fn noise(len: usize) -> Vec<u8> {
    let mut state = 88_172_645_463_325_252u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as u8
    };
    (0..len).map(|_| next()).collect()
}

fn nrrd(more: &str, side: u64, data: &[u8]) -> Vec<u8> {
    let mut file = format!(
        "NRRD0004\n{more}type: double\ndimension: 3\nsizes: {side} {side} {side}\n\
         spacings: 1 1 1\nendian: little\n\n"
    )
    .into_bytes();
    file.extend(data);
    file
}

fn meta(more: &str, side: u64, data: &[u8]) -> Vec<u8> {
    let mut file = format!(
        "NDims = 3\nDimSize = {side} {side} {side}\nElementType = MET_DOUBLE\n\
         ElementSpacing = 1 1 1\n{more}ElementDataFile = LOCAL\n"
    )
    .into_bytes();
    file.extend(data);
    file
}

fn nifti(side: i16, data: &[u8]) -> Vec<u8> {
    let mut file = NiftiHeader { code: 64, ..NiftiHeader::default() }.bytes();
    for at in [42, 44, 46] {
        file[at..at + 2].copy_from_slice(&side.to_le_bytes());
    }
    file.extend(data);
    file
}

/// Doubles: 644 a side are 2.1 GB, 500 are 1 GB, which a megabyte of deflate could stand for.
#[test]
fn a_volume_that_claims_more_than_its_file_holds_takes_no_memory_for_it() {
    if !child::alone("memory::a_volume_that_claims_more_than_its_file_holds_takes_no_memory_for_it")
    {
        return;
    }
    for (side, len) in [(644, 1000), (500, 1_000_000), (100, 1_000_000)] {
        let data = noise(len);
        let what = format!("{len} bytes that claim {side} a side");
        let wide = u64::from(side as u16);
        refuses("a.nii", &what, &nifti(side, &data));
        refuses("a.nii.gz", &what, &gzip(&nifti(side, &data)));
        for (encoding, data) in
            [("raw", data.clone()), ("ascii", b"1 ".repeat(len / 2)), ("gzip", gzip(&data))]
        {
            let encoding = format!("encoding: {encoding}\n");
            refuses("a.nrrd", &format!("{what}, {encoding}"), &nrrd(&encoding, wide, &data));
        }
        for (more, data) in [
            ("", data.clone()),
            ("CompressedData = True\n", zlib(&data)),
            ("CompressedData = True\n", gzip(&data)),
            ("BinaryData = False\n", b"1 ".repeat(len / 2)),
        ] {
            refuses("a.mha", &format!("{what}, {more}"), &meta(more, wide, &data));
        }
    }
}

/// As [`nrrd`] and [`meta`], the samples in a file of their own.
#[test]
fn a_detached_header_that_claims_more_than_its_data_file_takes_no_memory_for_it() {
    if !child::alone(
        "memory::a_detached_header_that_claims_more_than_its_data_file_takes_no_memory_for_it",
    ) {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let data = zlib(&noise(1_000_000));
    std::fs::write(dir.path().join("d.raw"), &data).unwrap();
    let header = meta("CompressedData = True\n", 500, b"");
    let header = String::from_utf8(header).unwrap().replace("LOCAL", "d.raw");
    std::fs::write(dir.path().join("a.mhd"), &header).unwrap();
    refuses_path(&dir.path().join("a.mhd"), "compressed", data.len() + header.len());
    let header = nrrd("data file: d.raw\nencoding: raw\n", 500, b"");
    std::fs::write(dir.path().join("a.nhdr"), &header).unwrap();
    refuses_path(&dir.path().join("a.nhdr"), "raw", data.len() + header.len());
}

/// A megabyte of fields that nobody reads, and a field of a megabyte.
#[test]
fn headers_of_many_or_long_fields_take_no_more_than_their_bytes() {
    if !child::alone("memory::headers_of_many_or_long_fields_take_no_more_than_their_bytes") {
        return;
    }
    let many = |separator: &str| -> String {
        (0..100_000).map(|i| format!("{i:x}{separator}\n")).collect()
    };
    refuses("a.nrrd", "many fields", &nrrd(&many(":"), 9, &[]));
    refuses("a.mha", "many fields", &meta(&many("="), 9, &[]));
    let long = "1 ".repeat(500_000);
    let text = refuses("a.nrrd", "a long field", &nrrd(&format!("space origin: {long}\n"), 9, &[]));
    assert!(text.contains("at most 65536"), "{text}");
    let text = refuses("a.mha", "a long field", &meta(&format!("Offset = {long}\n"), 9, &[]));
    assert!(text.contains("at most 65536"), "{text}");
    // Bytes that are no text grow threefold in a reader that wants text.
    let mut file = b"NRRD0004\n".to_vec();
    file.extend(vec![0xff; 3_000_000]);
    refuses("a.nrrd", "no lines", &file);
    refuses("a.mha", "no lines", &file);
}

#[test]
fn a_dicom_file_that_claims_gigabytes_takes_no_memory_for_it() {
    if !child::alone("memory::a_dicom_file_that_claims_gigabytes_takes_no_memory_for_it") {
        return;
    }
    let find = |bytes: &[u8], what: &[u8]| {
        bytes.windows(what.len()).position(|w| w == what).expect("in the file")
    };
    let mut slice = dicom_slice(&volumes::Slice::default());
    let rows = find(&slice, &[0x28, 0, 0x10, 0, b'U', b'S', 2, 0]) + 8;
    slice[rows..rows + 2].copy_from_slice(&60000u16.to_le_bytes());
    slice[rows + 10..rows + 12].copy_from_slice(&60000u16.to_le_bytes());
    refuses("a.dcm", "60000 x 60000 pixels", &slice);
    for vr in [b"OB", b"UN", b"UT", b"SQ", b"ZZ"] {
        let mut slice = dicom_slice(&volumes::Slice::default());
        let at = find(&slice, b"\x20\0\x0e\0UI");
        let mut element = b"\x18\0\x18\x90".to_vec();
        element.extend(vr);
        element.extend([0, 0]);
        element.extend(0xffff_fff0u32.to_le_bytes());
        slice.splice(at..at, element);
        refuses("a.dcm", "an element of 4 GB", &slice);
    }
}

/// Run lengths were decoded into memory for whatever size the elements claimed.
#[test]
fn run_lengths_of_a_frame_that_claims_gigabytes_take_no_memory_for_it() {
    if !child::alone("memory::run_lengths_of_a_frame_that_claims_gigabytes_take_no_memory_for_it") {
        return;
    }
    for (side, len, wanted) in [
        (60_000u16, 100_000, "compressed pixels; 67108864 at most"),
        (30_000, 1000, "compressed pixels; 67108864 at most"),
        (8_000, 1000, "bytes for 8000x8000 pixels"),
    ] {
        let syntax = "1.2.840.10008.1.2.5";
        let slice = volumes::Slice { syntax, size: [side; 2], ..volumes::Slice::default() };
        let mut file = dicom_slice(&slice);
        let at = file.windows(4).rposition(|w| w == b"\xe0\x7f\x10\0").expect("pixels");
        file.truncate(at);
        file.extend(b"\xe0\x7f\x10\0OB\0\0\xff\xff\xff\xff\xfe\xff\0\xe0\0\0\0\0");
        // Two segments, each of runs of 128 zeros.
        let mut stream: Vec<u8> = [2u32, 64, 64].iter().flat_map(|w| w.to_le_bytes()).collect();
        stream.resize(64, 0);
        stream.extend([0x81, 0].repeat((len - 64) / 2));
        file.extend(b"\xfe\xff\0\xe0");
        file.extend((stream.len() as u32).to_le_bytes());
        file.extend(stream);
        file.extend(b"\xfe\xff\xdd\xe0\0\0\0\0");
        let said = refuses("rle.dcm", &format!("{side} x {side} pixels"), &file);
        assert!(said.contains(wanted), "{said}");
    }
}

/// Slices of the same place: refused when all heads have been read.
#[test]
fn a_folder_of_many_small_dicom_files_takes_no_more_than_its_bytes() {
    if !child::alone("memory::a_folder_of_many_small_dicom_files_takes_no_more_than_its_bytes") {
        return;
    }
    let mut slice = volumes::Slice { implicit: true, canary: "", ..volumes::Slice::default() };
    let size = dicom_slice(&slice).len();
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("series");
    std::fs::create_dir(&folder).unwrap();
    let count = 10_000;
    for i in 0..count {
        // A slice that repeats the one before would be left out.
        slice.pixels[0] = i as u16 % 4096;
        std::fs::write(folder.join(i.to_string()), dicom_slice(&slice)).unwrap();
    }
    refuses_path(&folder, "many slices in one place", count * size);
}

#[test]
fn a_mesh_that_claims_more_than_its_file_holds_takes_no_memory_for_it() {
    if !child::alone("memory::a_mesh_that_claims_more_than_its_file_holds_takes_no_memory_for_it") {
        return;
    }
    let tail = noise(1000);
    let with = |head: &str| [head.as_bytes(), &tail].concat();
    for format in ["binary_little_endian", "binary_big_endian", "ascii"] {
        let head = |vertices: u64, faces: u64| {
            format!(
                "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\n\
                 property float y\nproperty float z\nelement face {faces}\n\
                 property list uint int vertex_indices\nend_header\n"
            )
        };
        let text = |n: u64, m: u64| match format {
            "ascii" => format!("{}4000000000 0 1 2", head(n, m)).into_bytes(),
            _ => with(&head(n, m)),
        };
        refuses("a.ply", &format!("{format}, vertices"), &text(200_000_000, 1));
        refuses("a.ply", &format!("{format}, faces"), &text(0, 200_000_000));
        refuses("a.ply", &format!("{format}, a list"), &text(0, 1));
    }
    let mut stl = vec![b' '; 80];
    stl.extend(40_000_000u32.to_le_bytes());
    stl.extend(&tail);
    refuses("a.stl", "triangles", &stl);
    refuses("a.stl", "text", b"solid a\nfacet\nouter loop\nvertex 0 0 0\nvertex 1 1");
    refuses("a.obj", "a face of vertices that are not there", b"v 0 0 0\nf 1 2000000000 3\n");
    let vtp = |points: &str, offset: &str, data: &[u8]| {
        let head = format!(
            "<VTKFile type=\"PolyData\" header_type=\"UInt64\"><PolyData><Piece \
             NumberOfPoints=\"{points}\" NumberOfPolys=\"1\"><Points><DataArray type=\"Float32\" \
             NumberOfComponents=\"3\" format=\"appended\" offset=\"{offset}\"/></Points></Piece>\
             </PolyData><AppendedData encoding=\"raw\">_"
        );
        [head.as_bytes(), data].concat()
    };
    refuses("a.vtp", "a block of 2 GB", &vtp("3", "0", &2_000_000_000u64.to_le_bytes()));
    refuses("a.vtp", "an offset of 2 GB", &vtp("3", "2000000000", &tail));
    let no_data = [&0u64.to_le_bytes()[..], &tail].concat();
    refuses("a.vtp", "2 billion points", &vtp("2000000000", "0", &no_data));
    // Compressed blocks: how many, their size, the last one's, and compressed sizes.
    let blocks = |words: &[u64]| {
        let words: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).collect();
        let file = vtp("3", "0", &[&words[..], &tail].concat());
        let text = String::from_utf8_lossy(&file[..80]).into_owned();
        let tag = "<VTKFile compressor=\"vtkZLibDataCompressor\"";
        [text.replacen("<VTKFile", tag, 1).as_bytes(), &file[80..]].concat()
    };
    refuses("a.vtp", "2 billion blocks", &blocks(&[2_000_000_000, 8, 8]));
    refuses("a.vtp", "a compressed block of 2 GB", &blocks(&[1, 2_000_000_000, 0, 900]));
    refuses("a.vtp", "blocks that share bytes", &blocks(&[100, 900_000, 0, 900, 900, 900]));
}

#[test]
fn mesh_headers_of_many_declarations_take_no_more_than_their_bytes() {
    if !child::alone("memory::mesh_headers_of_many_declarations_take_no_more_than_their_bytes") {
        return;
    }
    for (what, line) in [("elements", "element e 0\n"), ("properties", "property int8 p\n")] {
        let lines = line.repeat(10_000_000 / line.len());
        let text =
            format!("ply\nformat ascii 1.0\nelement e 0\n{lines}element vertex 9\nend_header\n");
        refuses("a.ply", what, text.as_bytes());
    }
    let arrays = "<DataArray/>".repeat(500_000);
    let text = format!("<VTKFile type=\"PolyData\"><Piece NumberOfPoints=\"0\">{arrays}</Piece>");
    refuses("a.vtp", "arrays", text.as_bytes());
}

/// Refused at its last vertex; until then everything was well.
#[test]
fn a_mesh_refused_at_its_end_takes_no_more_than_its_bytes() {
    if !child::alone("memory::a_mesh_refused_at_its_end_takes_no_more_than_its_bytes") {
        return;
    }
    let obj = format!("{}f 1 2 300000\n", "v 0 0 1\nf 1 1 1 1 1 1 1 1\n".repeat(200_000));
    refuses("a.obj", "its last face", obj.as_bytes());
    let fan = " 0".repeat(4_000_000);
    let ply = format!(
        "ply\nformat ascii 1.0\nelement face 1\nproperty list uint int vertex_indices\n\
         end_header\n4000001{fan} 7\n"
    );
    refuses("a.ply", "a polygon of 4 million vertices", ply.as_bytes());
    let facet = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n";
    let stl = format!("solid\n{}vertex nan 0 0\n", facet.repeat(100_000));
    refuses("a.stl", "its last vertex", stl.as_bytes());
}

#[test]
fn a_camera_path_that_is_refused_takes_no_more_than_its_bytes() {
    if !child::alone("memory::a_camera_path_that_is_refused_takes_no_more_than_its_bytes") {
        return;
    }
    let pose = "{\"seconds\":0,\"position\":[0,0,0],\"quaternion\":[0,0,0,1],\"near\":1}";
    let head = "{\"schema\":\"intima.path/1\",\"space\":\"LPS\",\"unit\":\"mm\",\"fov_y_deg\":70";
    for (what, json) in [
        ("many poses", format!("{head},\"poses\":[{}]}}", vec![pose; 150_000].join(","))),
        ("no poses", format!("{head},\"poses\":[{}", "[".repeat(1_000_000))),
        ("an unknown list", format!("{head},\"more\":[{}", "0,".repeat(3_000_000))),
        ("a long name", format!("{{\"schema\":\"{}", "x".repeat(5_000_000))),
    ] {
        let (taken, read) = peak(|| CameraPath::parse(json.as_bytes()));
        assert!(read.is_err(), "{what}");
        drop(read);
        assert_small(&format!("camera path, {what}"), taken, json.len());
    }
}
