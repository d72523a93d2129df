//! Where paths begin: a table of the shared volumes, by hand.

use common::fixtures::path;
use common::volumes::shared_file;
use glam::DVec3;
use intima::centerline::EndRule;
use intima::lumen::IntensitySelection;
use intima::organ::{Organ, OrganOptions};
use intima::session::{EndPoint, Session, Settings, Source, VolumeSource};
use intima::volume::phantom::{Kind, Phantom};
use intima::volume::{Grid, Volume};

fn session(file: std::path::PathBuf, select: IntensitySelection) -> Session {
    let mut settings = Settings::default();
    settings.lumen.select = Some(select);
    Session::new(Source::Image(VolumeSource::file(file)), settings).unwrap()
}

#[test]
fn paths_begin_at_the_trachea_the_rectum_or_the_trunk() {
    let table = std::fs::read_to_string(path("ends.csv")).unwrap();
    for row in table.lines().skip(2) {
        let [name, from, x, y, z, within, rule] = row.split(',').collect::<Vec<_>>()[..] else {
            panic!("{row}")
        };
        let number = |text: &str| text.parse::<f64>().unwrap();
        let Some(file) = shared_file(name) else { return };
        let select = match from {
            "" => IntensitySelection::Labels(Vec::new()),
            lo => IntensitySelection::Range { lo: number(lo), hi: f64::INFINITY },
        };
        let session = session(file, select);
        let centered = session.centerline().unwrap();
        let [start, end] = centered.ends.as_ref().unwrap();
        let wanted = DVec3::new(number(x), number(y), number(z));
        let off = DVec3::from(start.at_mm).distance(wanted);
        println!("{name}: {off:.1} mm, {start:?}, to {:?}", end.at_mm);
        assert!(off <= number(within), "{name}: {off:.1} mm from the start");
        let rule = if rule == "rectum" { EndRule::Rectum } else { EndRule::ThickestStem };
        assert_eq!((start.rule, end.rule), (rule, EndRule::FarthestTip), "{name}");
        assert!(!start.is_doubtful(), "{name}: {start:?}");
        assert!(centered.outside_mm.is_empty(), "{name}: points beyond the wall");
        let is_larynx = name.contains("c009");
        let [above, after] = centered.beyond_mm;
        assert_eq!(above.is_some_and(|mm| mm > 20.0), is_larynx, "{name}");
        // An ileum of 80 mm is joined to the first colon alone.
        let is_ileum = name.contains("colon_label_1");
        assert_eq!(after.is_some_and(|mm| mm > 60.0), is_ileum, "{name}: {after:?}");
    }
}

/// A tube in the form of a U, 640 mm long, with a thin one at its end.
fn colon_with_a_thin_tube(thin_mm: f64) -> Volume {
    let grid = Grid::axis_aligned([90, 40, 110], [3.0; 3]);
    let capsule = |p: DVec3, a: DVec3, b: DVec3, radius: f64| {
        let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
        p.distance(a.lerp(b, t)) < radius
    };
    // Feet and back first: a rectum.
    let corners = [[40., 90., 20.], [40., 60., 280.], [220., 60., 280.], [220., 60., 80.]];
    let corners = corners.map(DVec3::from);
    let is_inside = |p: DVec3| {
        let end = corners[3];
        let thin = DVec3::new(end.x - thin_mm, end.y - 18.0, end.z);
        corners.windows(2).any(|c| capsule(p, c[0], c[1], 18.0))
            || thin_mm > 0.0 && capsule(p, end, thin, 6.0)
    };
    let inside = |i| u8::from(is_inside(grid.voxel(i).as_dvec3() * 3.0));
    Volume::new(grid, (0..grid.len()).map(inside).collect::<Vec<u8>>().into())
}

#[test]
fn the_path_of_a_colon_ends_in_the_caecum_and_not_in_the_ileum() {
    let end_of = |thin_mm: f64| {
        let mut settings = Settings::default();
        settings.lumen.select = Some(IntensitySelection::Labels(Vec::new()));
        let volume = std::sync::Arc::new(colon_with_a_thin_tube(thin_mm));
        let source = Source::Image(VolumeSource::Memory(volume));
        let session = Session::new(source, settings).unwrap();
        let centered = session.centerline().unwrap();
        let [start, end] = centered.ends.clone().unwrap();
        assert_eq!(start.rule, EndRule::Rectum);
        (DVec3::from(end.at_mm), centered.beyond_mm[1])
    };
    let (alone, none) = end_of(0.0);
    let (with, beyond) = end_of(110.0);
    assert_eq!(none, None);
    assert!(alone.distance(with) < 30.0, "{alone} {with}");
    assert!(beyond.is_some_and(|mm| (60.0..110.0).contains(&mm)), "{beyond:?}");
}

#[test]
fn an_airway_that_was_found_is_flown_from_the_upper_end_of_its_trachea() {
    let Some(file) = shared_file("chest_ct_sharp_3mm.nrrd") else { return };
    let mut settings = Settings::default();
    settings.lumen.organ = Some(OrganOptions::from(Organ::Airway));
    let session = Session::new(Source::Image(VolumeSource::file(file)), settings).unwrap();
    let (centered, profile) = (session.centerline().unwrap(), session.lumen_profile().unwrap());
    let [start, end] = centered.ends.clone().unwrap();
    assert_eq!((start.rule, profile.start), (EndRule::Trachea, Some("trachea")));
    assert!(start.at_mm[2] > end.at_mm[2] + 100.0, "{start:?} {end:?}");
    let tree = session.tree().unwrap().unwrap();
    assert!(tree.generations[0] == 1 && tree.generation_radii_mm[0] > 5.0, "{tree:?}");
}

#[test]
fn ends_by_name_are_the_root_and_the_tips_of_the_tree() {
    let y = std::sync::Arc::new(Phantom::new(Kind::Y, 64, [1.0; 3]).unwrap().mask());
    let of = |from, to, tree| {
        let mut settings = Settings::default();
        settings.lumen.select = Some(IntensitySelection::Labels(Vec::new()));
        settings.centerline.from = from;
        settings.centerline.to = to;
        settings.centerline.tree = tree;
        let source = Source::Image(VolumeSource::Memory(y.clone()));
        Session::new(source, settings).unwrap().centerline()
    };
    let tree = of(None, None, true).unwrap();
    let tip = |branch: usize| tree.line.branches[branch].points.last().unwrap().position_mm;
    let last = tree.line.branches.len() - 1;
    let path = of(Some(EndPoint::Tip(last)), Some(EndPoint::Root), false).unwrap();
    let points = &path.line.branches[0].points;
    assert!(points[0].position_mm.distance(tip(last)) < 1e-6);
    let root = tree.line.branches[0].points[0].position_mm;
    assert!(points[points.len() - 1].position_mm.distance(root) < 1e-6);
    let none = of(Some(EndPoint::Tip(99)), None, false).err().unwrap();
    assert!(none.to_string().contains("no branch 99"), "{none}");
}

/// The straight distance between its ends once decided whether a piece was flown.
#[test]
fn a_bent_piece_whose_ends_lie_beside_each_other_is_flown() {
    let grid = Grid::axis_aligned([72, 72, 40], [1.0; 3]);
    // A short wide tube, and a ring with a gap, three voxels wide at one end and eight at the other.
    let ring = |p: DVec3| {
        (0..=310).any(|degrees| {
            let at = f64::from(25 + degrees).to_radians();
            let centre = DVec3::new(24.0 + 16.0 * at.cos(), 44.0 + 16.0 * at.sin(), 20.0);
            p.distance(centre) <= 3.0 + 5.0 * f64::from(degrees) / 310.0
        })
    };
    let tube = |p: DVec3| {
        let along = p.z.clamp(12.0, 28.0);
        p.distance(DVec3::new(58.0, 12.0, along)) <= 10.0
    };
    let label = |i| {
        let p = grid.voxel(i).as_dvec3();
        u8::from(tube(p) || ring(p))
    };
    let volume = Volume::new(grid, (0..grid.len()).map(label).collect::<Vec<u8>>().into());
    let mut settings = Settings::default();
    settings.lumen.select = Some(IntensitySelection::Labels(vec![1]));
    settings.lumen.all_components = true;
    let source = Source::Image(VolumeSource::Memory(std::sync::Arc::new(volume)));
    let session = Session::new(source, settings).unwrap();
    let line = &session.centerline().unwrap().line;
    assert_eq!(line.branches.len(), 2);
    let longest = line.branches.iter().map(|b| b.points.last().unwrap().abscissa_mm);
    assert!(longest.fold(0.0, f64::max) > 70.0);
}

/// The way to a pocket was left out as a branch, and came back as a loop that is not closed.
#[test]
fn a_pocket_of_a_colon_is_no_branch_of_its_tree() {
    let Some(file) = shared_file("colon_label_1.nii.gz") else { return };
    let mut settings = Settings::default();
    settings.lumen.select = Some(IntensitySelection::Labels(vec![1]));
    settings.centerline.tree = true;
    let session = Session::new(Source::Image(VolumeSource::file(file)), settings).unwrap();
    assert_eq!(session.centerline().unwrap().line.branches.len(), 1);
}
