//! Round trips through bytes, and refusal of all other bytes.

use super::*;

fn written() -> (Mesh, Parameterization, Vec<u8>) {
    let mesh = patch();
    let mut maps = Parameterization::new(&mesh).unwrap();
    simplify(&mesh, 300, 11, &mut maps);
    let bytes = maps.to_bytes();
    (mesh, maps, bytes)
}

/// The bytes with a right hash at the end.
fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let end = bytes.len() - 32;
    let hash = blake3::hash(&bytes[..end]);
    bytes[end..].copy_from_slice(hash.as_bytes());
    bytes
}

#[test]
fn what_is_written_is_read_back_and_maps_alike() {
    for Case { name, mesh, maps } in cases() {
        let read = Parameterization::from_bytes(&maps.to_bytes(), &mesh).unwrap();
        assert_eq!(read.to_bytes(), maps.to_bytes(), "{name}");
        assert_eq!(read.triangles, maps.triangles, "{name}");
        assert_eq!(read.removed_vertices(), maps.removed_vertices(), "{name}");
    }
    let none = Parameterization::new(&Mesh::default()).unwrap();
    assert_eq!(
        Parameterization::from_bytes(&none.to_bytes(), &Mesh::default()).unwrap().collapses(),
        0
    );
}

#[test]
fn a_file_of_another_mesh_version_or_length_is_refused_by_name() {
    let (mesh, _, bytes) = written();
    let read = |bytes: &[u8], mesh: &Mesh| {
        Parameterization::from_bytes(bytes, mesh).map(|_| ()).unwrap_err()
    };
    let mut moved = mesh.clone();
    moved.positions[17].x += 1e-5;
    let mut turned = mesh.clone();
    turned.faces[3].rotate_left(1);
    for other in [moved, turned, torus(), Mesh::default()] {
        let e = read(&bytes, &other);
        assert!(matches!(e, ParameterizationError::OtherMesh { .. }), "{e}");
    }
    let mut newer = bytes.clone();
    newer[8] = 9;
    assert!(matches!(read(&sealed(newer), &mesh), ParameterizationError::Version { found: 9 }));
    assert!(matches!(read(b"ply\nformat ascii 1.0", &mesh), ParameterizationError::Magic));
    assert!(matches!(read(b"", &mesh), ParameterizationError::Magic));
    for n in (8..bytes.len()).step_by(61) {
        assert!(
            matches!(read(&bytes[..n], &mesh), ParameterizationError::Length { .. }),
            "{n} bytes"
        );
    }
    let longer = [&bytes[..], &[0]].concat();
    assert!(matches!(read(&longer, &mesh), ParameterizationError::Length { .. }));
    let mut damaged = bytes.clone();
    damaged[5000] ^= 4;
    assert!(matches!(read(&damaged, &mesh), ParameterizationError::Damaged));
}

#[test]
fn counts_that_ask_for_more_than_is_there_take_no_memory() {
    let (mesh, _, bytes) = written();
    for at in [20, 24] {
        let mut greedy = bytes.clone();
        greedy[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
        let e = Parameterization::from_bytes(&sealed(greedy), &mesh).map(|_| ()).unwrap_err();
        let ParameterizationError::Length { wanted, found } = e else { panic!("{e}") };
        assert!(wanted > 30_000_000_000 && found < 1_000_000, "{wanted} of {found}");
    }
}

/// A liar can seal any content; whatever is accepted must still be a bijection.
#[test]
fn changed_words_under_a_right_hash_are_refused_or_harmless() {
    let (mesh, maps, bytes) = written();
    let (mut refused, mut dice) = (0, Dice::new(99));
    let header = 96;
    for n in 0..1500 {
        let mut changed = bytes.clone();
        let word = header + 4 * dice.below((bytes.len() - header - 32) / 4);
        let value = match dice.below(4) {
            0 => dice.below(3000) as u32,
            1 => f32::NAN.to_bits(),
            2 => u32::MAX,
            _ => u32::from_le_bytes([0, 1, 2, 3].map(|i| bytes[word + i])) ^ 1 << dice.below(32),
        };
        changed[word..word + 4].copy_from_slice(&value.to_le_bytes());
        let Ok(read) = Parameterization::from_bytes(&sealed(changed), &mesh) else {
            refused += 1;
            continue;
        };
        // A vertex moved in the plane is still a map between the same two meshes.
        assert!(read.base_faces().eq(maps.base_faces()), "change {n}");
        let all: Vec<u32> = (0..mesh.faces.len() as u32).collect();
        let gap = fine_round_trip(&mesh, &read, &places(&all, 200, n));
        assert!(gap <= ROUND_TRIP * diagonal(&mesh), "change {n}: {gap:e}");
    }
    assert!(refused > 800, "{refused} refused");
}

#[test]
fn collapses_in_another_order_or_twice_are_refused() {
    let (mesh, maps, _) = written();
    let read = |maps: &Parameterization| {
        Parameterization::from_bytes(&maps.to_bytes(), &mesh).map(|_| ()).unwrap_err()
    };
    let mut twice = maps.clone();
    let (last, start) = (twice.records[twice.records.len() - 1], twice.entries.len());
    twice.entries.extend_from_within(last.start as usize..);
    twice.records.push(Record { start: start as u32, ..last });
    assert!(matches!(read(&twice), ParameterizationError::Record { .. }));
    let mut short = maps.clone();
    short.records.pop();
    short.entries.truncate(last.start as usize);
    assert!(matches!(read(&short), ParameterizationError::OtherBase));
    let mut renamed = maps.clone();
    renamed.records[5].from = 900_000;
    assert!(matches!(read(&renamed), ParameterizationError::Record { collapse: 5, .. }));
}
