//! The window without a display: scripts give the same bytes each time, and no move by hand takes
//! the eye's near plane through the wall.
#![cfg(feature = "window")]

use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;

use common::cast::Cast;
use common::html::Element;
use common::{torso, volumes};
use glam::{DQuat, DVec3, IVec3};
use intima::app::{Action, CoverageRecorder, Model, Ruler};
use intima::flight::Frames;
use intima::geometry::{Mesh, Vertex};
use intima::lumen::IntensitySelection;
use intima::session::{FlightRoute, Product, Session, Settings, Source, VolumeSource, WallForm};
use intima::volume::phantom::{Kind, Phantom};

fn session(kind: Kind, size: u32) -> Session {
    let mask = Phantom::new(kind, size, [1.0; 3]).unwrap().mask();
    let source = Source::Image(VolumeSource::Memory(Arc::new(mask)));
    Session::new(source, Settings::default()).unwrap()
}

/// A model that has everything but pictures.
fn model(session: &Session) -> Model {
    let wanted = [
        Product::Volume,
        Product::ValueRange,
        Product::Lumen,
        Product::Wall,
        Product::TriangleTree,
        Product::Fields,
        Product::Centerline,
        Product::Levels,
        Product::Flight,
    ];
    session.prepare(&wanted).unwrap();
    let mut model = Model::new(20.0);
    model.update(session.products(&wanted));
    model
}

/// Whether a segment meets a triangle.
fn is_cut(wall: &Cast, from: DVec3, to: DVec3) -> bool {
    from != to && wall.ray(from, to - from).is_some_and(|hit| hit.t <= 1.0)
}

/// The wall as it is drawn where no face is refined: the vertices of the mesh, put on the smooth wall.
fn flat_wall(session: &Session) -> Mesh {
    match &session.levels().unwrap().form {
        WallForm::Refined(wall) => {
            let positions = wall.shading().vertices.iter().map(Vertex::position).collect();
            Mesh { positions, faces: wall.faces().to_vec(), ..Mesh::default() }
        }
        _ => session.wall().unwrap().mesh.clone(),
    }
}

/// Moves at random and casts segments from each eye to the corners of its near plane, and from the
/// eye before to it: to the wall as it is drawn far from the eye, and near it.
fn wander(session: &Session, moves: u32) {
    let walls = [Cast::of(&flat_wall(session)), Cast::of(&session.refined_mesh(2).unwrap())];
    let is_cut = |from, to| walls.iter().any(|wall| is_cut(wall, from, to));
    let mut model = model(session);
    let length = model.path.as_ref().unwrap().length_mm();
    let mut seed = 7u64;
    let mut random = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as f64 / f64::from(1u32 << 31) - 0.5
    };
    let (mut flown, mut blocked) = (0.0, 0);
    for i in 0..moves {
        let before = model.pose.unwrap().position_mm.as_dvec3();
        let by = 8.0 * random();
        let action = match i % 7 {
            0 => Action::Turn([random() as f32, random() as f32, random() as f32]),
            // Now and then somewhere else, so that all of the organ is tried.
            1 if i % 350 == 1 => Action::Seek((random() + 0.5) * length),
            _ => Action::Fly([2.0 * random(), 2.0 * random(), by]),
        };
        model.step(0.0, std::slice::from_ref(&action));
        let pose = model.pose.unwrap();
        let eye = pose.position_mm.as_dvec3();
        let lens = model.lens();
        let half = f64::from((0.5 * lens.fov_y_rad).tan());
        for (x, y) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
            let corner = DVec3::new(x * half * f64::from(lens.aspect), y * half, -1.0);
            let corner = eye + pose.rotation.as_dquat() * (corner * f64::from(lens.near_mm));
            assert!(!is_cut(eye, corner), "move {i}: the near plane at {eye} cuts the wall");
        }
        if matches!(action, Action::Fly(_)) {
            assert!(!is_cut(before, eye), "move {i}: through the wall from {before} to {eye}");
            flown += before.distance(eye);
            blocked += u32::from(before.distance(eye) < 0.5 * by.abs());
        }
    }
    // The walk was one, and the wall was in its way.
    println!("{moves} moves, {flown:.0} mm flown, {blocked} held up by the wall");
    assert!(flown > f64::from(moves) && blocked > moves / 200, "{flown} mm, {blocked} blocked");
}

#[test]
fn no_move_by_hand_takes_the_near_plane_through_the_wall() {
    wander(&session(Kind::Bend, 64), 25_000);
    wander(&session(Kind::Y, 64), 25_000);
}

/// A session of a shared volume that has a mask or a threshold.
fn shared(name: &str, select: IntensitySelection) -> Option<Session> {
    let file = volumes::shared_data()?.join(name);
    let mut settings = Settings::default();
    settings.lumen.select = Some(select);
    settings.flight.frames = Frames::Speed { mm_per_s: 20.0, fps: 25.0 };
    Some(Session::new(Source::Image(VolumeSource::file(file)), settings).unwrap())
}

#[test]
#[ignore = "minutes: cargo test --release --test program no_million_moves -- --ignored"]
fn no_million_moves_by_hand_take_the_near_plane_through_a_phantoms_wall() {
    wander(&session(Kind::Bend, 96), 1_000_000);
    wander(&session(Kind::Y, 96), 1_000_000);
}

/// On the aorta a slide round a fold once ended where the straight way back cut the fold.
#[test]
#[ignore = "minutes: cargo test --release --test program no_million_moves -- --ignored"]
fn no_million_moves_by_hand_take_the_near_plane_through_a_real_wall() {
    let colon = shared("colon_label_1.nii.gz", IntensitySelection::Labels(vec![1]));
    let range = IntensitySelection::Range { lo: 1100.0, hi: f64::INFINITY };
    let aorta = shared("aorta_mra.mha", range);
    for session in colon.iter().chain(&aorta) {
        wander(session, 1_000_000);
    }
}

#[test]
fn on_real_lumens_gaze_and_horizon_turn_no_faster_than_30_degrees_a_second() {
    let above = |lo| IntensitySelection::Range { lo, hi: f64::INFINITY };
    let label = || IntensitySelection::Labels(vec![1]);
    for (name, select) in [
        ("colon_label_1.nii.gz", label()),
        ("colon_label_2.nii.gz", label()),
        ("airway_label_lidc1.nii.gz", label()),
        ("airway_label_lidc4.nii.gz", label()),
        ("aorta_mra.mha", above(1100.0)),
        ("aneurism.nrrd", above(60.0)),
    ] {
        let Some(session) = shared(name, select) else { return };
        let flight = session.flight().unwrap();
        let (mut gaze, mut roll) = (0.0f64, 0.0f64);
        for (i, w) in flight.poses.windows(2).enumerate() {
            if flight.cuts.contains(&(i + 1)) {
                continue;
            }
            let [a, b] = [&w[0], &w[1]].map(|p| p.forward().as_dvec3().normalize());
            gaze = gaze.max(25.0 * a.angle_between(b).to_degrees());
            // What is left once the first is turned onto the second gaze by the shortest way.
            let up = DQuat::from_rotation_arc(a, b) * w[0].up().as_dvec3();
            roll = roll.max(25.0 * up.angle_between(w[1].up().as_dvec3()).to_degrees());
        }
        let moved = flight.moved;
        println!("{name}: gaze {gaze:.1} deg/s, roll {roll:.2} deg/s at most, {moved} moved");
        assert!(gaze < 30.2 && roll < 30.0, "{name}: {gaze} {roll}");
    }
}

#[test]
fn playing_stops_at_the_end_and_begins_anew_from_it() {
    let session = session(Kind::Tube, 48);
    let mut model = model(&session);
    let length = model.path.as_ref().unwrap().length_mm();
    model.step(0.0, &[Action::Speed(300.0), Action::TogglePlay]);
    (0..10_000).for_each(|_| model.step(0.1, &[]));
    assert!(!model.playing && (model.arc_mm - length).abs() < 1e-6);
    model.step(0.0, &[Action::TogglePlay]);
    assert!(model.playing && model.arc_mm == 0.0);
    model.step(0.1, &[Action::Reverse]);
    model.step(9.0, &[]);
    assert!(!model.playing && model.arc_mm == 0.0);
    // Numbers that are none change nothing.
    let (pose, fov) = (model.pose, model.fov_deg);
    let nan = [f64::NAN; 3];
    let bad = [Action::Fly(nan), Action::Seek(f64::NAN), Action::FieldOfView(f32::NAN)];
    model.step(0.0, &bad);
    model.step(0.0, &[Action::Crosshair(nan), Action::Turn([f32::NAN; 3])]);
    assert_eq!((model.pose, model.fov_deg), (pose, fov));
}

#[test]
fn bookmarks_lead_back_to_where_they_were_made() {
    let session = session(Kind::Bend, 48);
    let mut model = model(&session);
    model.step(0.0, &[Action::Seek(20.0), Action::Bookmark("fold".into())]);
    let on_path = model.pose;
    model.step(0.0, &[Action::Turn([0.4, 0.1, 0.0]), Action::Fly([0.5, 0.0, 1.0])]);
    model.step(0.0, &[Action::Bookmark(" ".into())]);
    let off_path = model.pose.unwrap();
    model.step(0.0, &[Action::GoToBookmark(0)]);
    assert_eq!((model.pose, model.on_path), (on_path, true));
    model.step(0.0, &[Action::GoToBookmark(1), Action::GoToBookmark(9)]);
    let back = model.pose.unwrap();
    assert!(back.position_mm.distance(off_path.position_mm) < 1e-4 && !model.on_path);
    assert_eq!(model.bookmarks[1].text, "Place 2");
    model.step(0.0, &[Action::RemoveBookmark(0), Action::RemoveBookmark(5)]);
    assert_eq!(model.bookmarks.len(), 1);
}

#[test]
fn coverage_recorded_while_flying_equals_the_figure_of_the_whole_flight() {
    let session = session(Kind::Y, 48);
    let (wall, flight) = (session.wall().unwrap(), session.flight().unwrap());
    let views: Vec<_> =
        flight.poses.iter().enumerate().map(|(i, p)| (*p, flight.lens(i))).collect();
    let offline = session.coverage().unwrap();
    let of = (wall, session.triangle_tree().unwrap(), session.exterior().unwrap());
    let mut recorder = CoverageRecorder::spawn(of, || {}).unwrap();
    // In any order, in batches of any size, and some views twice.
    let mut order: Vec<usize> = (0..views.len()).map(|i| i * 37 % views.len()).collect();
    order.extend(0..views.len());
    let mut last = None;
    for (i, batch) in order.chunks(7).enumerate() {
        recorder.add(&batch.iter().map(|k| views[*k]).collect::<Vec<_>>());
        if i % 3 == 0 {
            last = recorder.poll().or(last);
        }
    }
    let seen = recorder.settle().or(last).unwrap();
    assert_eq!(seen.faces, offline.seen_one_way);
    assert_eq!(seen.fraction, offline.one_way_fraction);
    assert!(seen.fraction > 0.3 && seen.fraction < 1.0, "{}", seen.fraction);
    assert!(recorder.settle().is_none(), "nothing more was added");
}

#[test]
fn cross_sections_along_a_tube_are_its_circle() {
    let session = session(Kind::Tube, 64);
    let mut model = model(&session);
    let length = model.path.as_ref().unwrap().length_mm();
    let lumen = session.lumen().unwrap();
    for share in [0.3, 0.5, 0.7] {
        model.step(0.0, &[Action::Seek(share * length)]);
        let s = model.section_figures().unwrap();
        let round = (s.area_mm2 / std::f64::consts::PI).sqrt();
        // As many square millimetres as there are voxels across the tube, which lies at an angle.
        let z = model.pose.unwrap().position_mm.z.round() as i32;
        let across = (0..64).flat_map(|x| (0..64).map(move |y| IVec3::new(x, y, z)));
        let along = model.path.as_ref().unwrap().tangent_at(model.arc_mm);
        let voxels = across.filter(|v| lumen.lumen.holds(*v)).count() as f64 * along.z.abs();
        assert!((s.area_mm2 / voxels - 1.0).abs() < 0.04, "{} {voxels}", s.area_mm2);
        assert!(s.largest_mm - s.smallest_mm < 1.0 && s.largest_mm >= s.smallest_mm);
        assert!((0.5 * s.largest_mm - round).abs() < 0.5);
    }
    // What is clicked in the middle of the picture lies on the wall, straight ahead.
    model.step(0.0, &[Action::Turn([1.2, 0.0, 0.0])]);
    let (pose, hit) = (model.pose.unwrap(), model.wall_behind(DVec3::NEG_Z).unwrap());
    let cast = Cast::of(&session.wall().unwrap().mesh);
    let eye = pose.position_mm.as_dvec3();
    let wanted = cast.ray(eye, pose.forward().as_dvec3()).unwrap().point;
    assert!(hit.distance(wanted) < 1e-4, "{hit} {wanted}");
    // Two clicks are a length.
    model.step(0.0, &[Action::Measure(Some(Ruler::Length)), Action::Mark(eye.to_array())]);
    model.step(0.0, &[Action::Mark([f64::NAN; 3]), Action::Mark(hit.to_array())]);
    assert!((model.measurements[0].value() - eye.distance(hit)).abs() < 1e-9);
    assert!(model.marks_mm.is_empty() && model.has_unsaved_notes());
}

/// Cross-sections at the poses of a session's flight, and how many there are of how many.
fn sections(session: &Session) -> (Vec<f64>, f64) {
    let all = session.sections().unwrap();
    let areas: Vec<f64> = all.iter().flatten().map(|s| s.area_mm2).collect();
    let share = areas.len() as f64 / all.len() as f64;
    (areas, share)
}

#[test]
fn a_section_in_a_bend_is_the_circle_of_its_tube_or_empty() {
    let session = session(Kind::Bend, 64);
    let (areas, share) = sections(&session);
    // The axis has the radius at its points.
    let radii = Phantom::new(Kind::Bend, 64, [1.0; 3]).unwrap().truth().branches[0].points.clone();
    let radius = radii.iter().map(|p| p[3]).fold(0.0, f64::max);
    let circle = std::f64::consts::PI * radius * radius;
    let most = areas.iter().copied().fold(0.0, f64::max);
    println!(
        "bend: {:.0} % have a section, {most:.1} mm2 at most, circle {circle:.1}",
        100.0 * share
    );
    assert!(most < 1.12 * circle && share > 0.9, "{most} {circle} {share}");
}

#[test]
fn a_section_between_haustra_is_never_one_along_the_lumen() {
    let session = session(Kind::Colon, 96);
    let (areas, share) = sections(&session);
    let radii = Phantom::new(Kind::Colon, 96, [1.0; 3]).unwrap().truth().branches[0].points.clone();
    let widest = radii.iter().map(|p| p[3]).fold(0.0, f64::max);
    let most = areas.iter().copied().fold(0.0, f64::max);
    let circle = std::f64::consts::PI * widest * widest;
    println!(
        "haustra: {:.0} % have a section, {most:.0} mm2 at most, widest ball {circle:.0}",
        100.0 * share
    );
    assert!(most < 2.0 * circle && share > 0.7, "{most} {circle} {share}");
}

/// With the plane across each step of the path the largest section of this colon was 15,506 mm².
#[test]
fn no_section_of_a_real_colon_runs_along_its_lumen() {
    let labels = IntensitySelection::Labels(vec![1]);
    let Some(session) = shared("colon_label_1.nii.gz", labels) else { return };
    let (areas, share) = sections(&session);
    let most = areas.iter().copied().fold(0.0, f64::max);
    println!("colon: {:.0} % have a section, {most:.0} mm2 at most", 100.0 * share);
    assert!(most < 5000.0 && share > 0.6, "{most} {share}");
}

#[test]
fn the_speed_shown_is_the_speed_flown() {
    let session = session(Kind::Colon, 64);
    let mut model = model(&session);
    assert_eq!(model.flown_mm_s(), None, "it stands");
    model.step(0.0, &[Action::Speed(60.0), Action::TogglePlay]);
    let place = |m: &Model| m.pose.unwrap().position_mm.as_dvec3();
    let (dt, mut ways, mut slowest) = (1.0 / 30.0, Vec::new(), f64::INFINITY);
    for _ in 0..60 {
        let before = place(&model);
        model.step(dt, &[]);
        ways.push(before.distance(place(&model)));
        let last: Vec<f64> = ways.iter().rev().take(13).copied().collect();
        let flown = last.iter().sum::<f64>() / (dt * last.len() as f64);
        let shown = model.flown_mm_s().unwrap();
        assert!((shown - flown).abs() < 0.05 * flown + 0.1, "shown {shown}, flown {flown}");
        slowest = slowest.min(shown);
    }
    assert!(slowest < 50.0, "the setting is 60 mm/s, and it is never slower: {slowest}");
    // A jump is not flown, and by hand it is the way that the wall left.
    model.step(0.0, &[Action::TogglePlay, Action::Seek(0.0)]);
    model.step(dt, &[]);
    assert_eq!(model.flown_mm_s(), None);
    let before = place(&model);
    model.step(dt, &[Action::Fly([0.0, 0.0, 1.0])]);
    let flown = before.distance(place(&model)) / dt;
    assert!((model.flown_mm_s().unwrap() - flown).abs() < 1e-3 * flown + 1e-6);
}

#[test]
fn off_the_path_the_figures_are_those_of_the_eye() {
    let session = session(Kind::Tube, 64);
    let mut model = model(&session);
    let length = model.path.as_ref().unwrap().length_mm();
    model.step(0.0, &[Action::Seek(0.5 * length)]);
    let (on, area) = (model.eye_to_wall_mm().unwrap(), model.section_figures().unwrap().area_mm2);
    let from = model.pose.unwrap().position_mm;
    model.step(0.0, &[Action::Fly([2.0, 0.0, 0.0])]);
    let off = model.eye_to_wall_mm().unwrap();
    let moved = f64::from(model.pose.unwrap().position_mm.distance(from));
    assert!(!model.on_path && (on - off - moved).abs() < 0.5, "{on} {off} after {moved}");
    // Across the tube, wherever the eye looks.
    for turn in [0.0, 0.8, 0.8] {
        model.step(0.0, &[Action::Turn([turn, 0.0, 0.0])]);
        let here = model.section_figures().unwrap().area_mm2;
        assert!((here / area - 1.0).abs() < 0.03, "{here} {area}");
    }
}

#[test]
fn progress_is_of_the_whole_case_and_never_goes_back() {
    let session = session(Kind::Colon, 96);
    let groups: [&[Product]; 2] = [&[Product::Wall], &[Product::Wall, Product::Coverage]];
    let mut last = 0.0f32;
    let mut at_the_wall = None;
    std::thread::scope(|scope| {
        let work = scope.spawn(|| session.prepare_in_order(&groups));
        while !work.is_finished() {
            let share = session.progress().share;
            assert!(share >= last, "{share} after {last}");
            last = share;
            let has_wall = session.products(&[Product::Wall]).wall.is_some();
            at_the_wall = at_the_wall.or(has_wall.then_some(share));
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        work.join().unwrap().unwrap();
    });
    let at_the_wall = at_the_wall.expect("the wall comes before the end");
    assert!(at_the_wall < 0.8, "the rest is part of the same work: {at_the_wall}");
    assert_eq!(session.progress().share, 1.0);
}

#[test]
fn the_rectum_of_shared_colons_is_found_and_can_be_swapped_by_hand() {
    use intima::organ::ColonEnds;
    for (name, starts_at_rectum) in [
        ("colon_label_1.nii.gz", true),
        ("colon_label_2.nii.gz", true),
        ("colon_label_3.nii.gz", true),
    ] {
        let Some(session) = shared(name, IntensitySelection::Labels(vec![1])) else { return };
        let line = &session.centerline().unwrap().line;
        let points = &line.branches[0].points;
        let [start, end] = [points[0], points[points.len() - 1]].map(|p| p.position_mm);
        let ends = ColonEnds::of(start, end, line.length_mm()).unwrap();
        assert_eq!((ends.starts_at_rectum, ends.is_sure), (starts_at_rectum, true), "{name}");
    }
    let session = session(Kind::Bend, 48);
    let mut model = model(&session);
    assert!(model.ends.is_none(), "nobody says that it is a colon");
    model.step(0.0, &[Action::RectumAtStart(false)]);
    assert_eq!(model.ends.unwrap().names(), ["caecum", "rectum"]);
    assert!(model.has_unsaved_notes());
    model.step(0.0, &[Action::RectumAtStart(true)]);
    assert_eq!(model.ends.unwrap().names(), ["rectum", "caecum"]);
}

#[test]
fn a_click_flies_there_along_the_path_and_another_branch_can_be_taken() {
    let mask = Phantom::new(Kind::Y, 64, [1.0; 3]).unwrap().mask();
    let source = Source::Image(VolumeSource::Memory(Arc::new(mask)));
    let mut settings = Settings::default();
    settings.centerline.tree = true;
    let session = Session::new(source, settings).unwrap();
    let mut model = model(&session);
    let length = model.path.as_ref().unwrap().length_mm();
    let goal = model.path.as_ref().unwrap().pose_at(0.8 * length).position_mm.as_dvec3();
    model.step(0.0, &[Action::GoNear(goal.to_array())]);
    assert!(model.arc_mm == 0.0 && model.is_moving(), "it sets out");
    let mut before = 0.0;
    for _ in 0..600 {
        model.step(1.0 / 30.0, &[]);
        assert!(model.arc_mm >= before, "never back");
        before = model.arc_mm;
    }
    assert!(!model.is_moving() && (model.arc_mm - 0.8 * length).abs() < 1.0);
    // Any other movement ends it.
    model.step(0.0, &[Action::FlyTo(0.0), Action::Turn([0.1, 0.0, 0.0])]);
    assert!(!model.is_moving());
    let choice = *model.choices.last().expect("a Y has another branch");
    model.step(0.0, &[Action::Seek(choice.arc_mm - 5.0)]);
    assert!(model.offered().contains(&choice));
    let (pose, tip) = (model.pose.unwrap(), |m: &Model| {
        let path = m.path.as_ref().unwrap();
        path.pose_at(path.length_mm()).position_mm
    });
    let old = tip(&model);
    let route = FlightRoute::Leaf(choice.branch);
    let flight = session.flight_along(route).unwrap();
    model.take_branch(&flight, &session.sections_along(&flight).unwrap(), route);
    assert!(tip(&model).distance(old) > 10.0, "another end");
    let moved = model.pose.unwrap().position_mm.distance(pose.position_mm);
    assert!(moved < 1.0, "the eye stays where the ways part: {moved}");
    // The way back is a choice now.
    assert!(model.choices.iter().any(|c| c.branch == 0), "{:?}", model.choices);
}

fn fly(dir: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
    command.args(["fly", "mask.nrrd"]).args(args).current_dir(dir);
    command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    command.env_remove("INTIMA_FAULT").output().expect("the program starts")
}

fn folder() -> tempfile::TempDir {
    let tmp = tempfile::tempdir().unwrap();
    let mask = Phantom::new(Kind::Bend, 48, [1.0; 3]).unwrap().mask();
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &mask).unwrap();
    tmp
}

const SCRIPT: &str = r#"{"schema": "intima.script/1", "size": [640, 400], "steps": [
    {"wait": "complete"}, {"picture": "begin"},
    {"key": "Space"}, {"frames": 20}, {"key": "Space"}, {"picture": "played"},
    {"hold": ["W", 40]}, {"key": "B"}, {"picture": "flown"},
    {"pointer": [100, 200]}, {"drag": [160, 180]}, {"wheel": 2}, {"picture": "looked"},
    {"do": {"maximise": "axial"}}, {"picture": "axial"}, {"key": "Escape"},
    {"pointer": [200, 365]}, {"click": null}, {"frames": 30}, {"picture": "sought"},
    {"key": "V"}, {"picture": "cube"}, {"key": "V"}, {"picture": "panorama"}, {"key": "V"},
    {"key": "C"}, {"picture": "missed"}, {"key": "C"}, {"picture": "radius"},
    {"key": "M"}, {"pointer": [100, 150]}, {"click": null}, {"pointer": [150, 200]},
    {"click": null}, {"picture": "measured"},
    {"do": {"export": "view"}}, {"do": {"export": "report"}}]}"#;

#[test]
fn a_script_played_twice_gives_the_same_pictures_and_saves_its_bookmarks() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let script = SCRIPT.replace(r#"{"click": null}"#, r#""click""#);
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let mut all = Vec::new();
    for (out, threads) in [("a", "1"), ("b", "2")] {
        let session = format!("{out}.json");
        let args = ["--script", "s.json", "--frames-out", out, "--session", &session];
        let done = fly(tmp.path(), &[&args[..], &["--threads", threads]].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let names = [
            "begin", "played", "flown", "looked", "axial", "sought", "cube", "panorama", "missed",
            "radius", "measured",
        ];
        let read = |n: &str| std::fs::read(tmp.path().join(out).join(format!("{n}.png"))).unwrap();
        let pictures: Vec<Vec<u8>> = names.iter().map(|n| read(n)).collect();
        for (i, w) in pictures.windows(2).enumerate() {
            assert_ne!(w[0], w[1], "{} and {} differ", names[i], names[i + 1]);
        }
        let notes = std::fs::read_to_string(tmp.path().join(&session)).unwrap();
        let json: serde_json::Value = serde_json::from_str(&notes).unwrap();
        assert_eq!(json["schema"], "intima.session/1");
        assert_eq!(json["bookmarks"].as_array().unwrap().len(), 1);
        assert_eq!(json["measurements"].as_array().unwrap().len(), 1);
        let name = json["bookmarks"][0]["picture"].as_str().unwrap();
        let bookmark = intima::formats::read_png(&tmp.path().join(name)).unwrap();
        let view =
            intima::formats::read_png(&tmp.path().join(out).join("mask-view-1.png")).unwrap();
        assert_eq!((bookmark.0, bookmark.1), (view.0, view.1), "both are the inside pane");
        let html =
            std::fs::read_to_string(tmp.path().join(out).join("mask-report-1.html")).unwrap();
        let page = common::html::read(&html);
        let findings = page.by_id("findings").unwrap();
        assert!(findings.text.contains("1. Place 1") && findings.text.contains("Wall at"));
        assert!(page.by_id("measurements").is_some() && page.by_id("profile").is_some());
        let count = |e: &Element| e.all().iter().filter(|e| e.name == "img").count();
        assert_eq!((count(findings), count(&page)), (4, 9), "the view and three slices");
        assert!(!html.contains("mask.nrrd"), "no name of a file");
        let html = common::html::lasting(&html);
        all.push((pictures, notes.replace(&format!("{out}-bookmark"), "bookmark"), html));
    }
    assert!(all[0] == all[1], "the same bytes at any number of threads");
}

#[test]
fn a_session_opened_again_leads_to_the_same_pictures() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let write = |name: &str, steps: &str| {
        let text =
            format!(r#"{{"schema": "intima.script/1", "size": [640, 400], "steps": [{steps}]}}"#);
        std::fs::write(tmp.path().join(name), text).unwrap();
    };
    write(
        "make.json",
        r#"{"wait": "complete"}, {"do": {"seek": 20}}, {"do": {"bookmark": "on the path"}},
        {"do": {"field_of_view": 120}}, {"do": {"turn": [0.5, 0.2, 0.3]}},
        {"do": {"fly": [1.0, 0.5, 3.0]}}, {"do": {"bookmark": "off it"}}"#,
    );
    write(
        "back.json",
        r#"{"wait": "complete"}, {"do": {"go_to_bookmark": 1}}, {"do": {"export": "view"}},
        {"do": {"go_to_bookmark": 0}}, {"do": {"export": "view"}}"#,
    );
    for script in ["make", "back"] {
        let file = format!("{script}.json");
        let args = ["--script", &file, "--frames-out", script, "--session", "notes.json"];
        let done = fly(tmp.path(), &[&args[..], &[]].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    }
    let read = |name: &str| std::fs::read(tmp.path().join(name)).unwrap();
    assert!(read("notes-bookmark-2.png") == read("back/mask-view-1.png"), "off the path");
    assert!(read("notes-bookmark-1.png") == read("back/mask-view-2.png"), "on the path");
    assert_ne!(read("back/mask-view-1.png"), read("back/mask-view-2.png"));
}

#[test]
fn a_volume_is_opened_in_the_window_and_its_lumen_chosen_there() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let phantom = Phantom::new(Kind::Bend, 48, [1.0; 3]).unwrap();
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &phantom.mask()).unwrap();
    intima::formats::write_volume(&tmp.path().join("ct.nrrd"), &phantom.grey(None, 0)).unwrap();
    let script = r#"{"schema": "intima.script/1", "size": [640, 400], "steps": [
        {"frames": 2}, {"picture": "empty"},
        {"do": {"open": "ct.nrrd"}}, {"wait": "volume"}, {"picture": "grey"},
        {"do": {"lumen": {"range": [-2000, -500]}}}, {"wait": "complete"}, {"picture": "chosen"},
        {"do": {"open": "mask.nrrd"}}, {"wait": "complete"}, {"picture": "label"}]}"#;
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
    command.args(["fly", "--script", "s.json", "--frames-out", "out"]);
    let done = command.current_dir(tmp.path()).env_remove("INTIMA_FAULT").output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let read = |n: &str| std::fs::read(tmp.path().join("out").join(format!("{n}.png"))).unwrap();
    let pictures = ["empty", "grey", "chosen", "label"].map(read);
    for w in pictures.windows(2) {
        assert_ne!(w[0], w[1]);
    }
}

/// `fly` took `--lod off` for another form, and left `--core` out without a word.
#[test]
fn without_levels_of_detail_the_window_draws_the_whole_wall() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let phantom = Phantom::new(Kind::Colon, 96, [1.0; 3]).unwrap();
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &phantom.mask()).unwrap();
    let script = r#"{"schema": "intima.script/1", "size": [900, 600], "steps": [
        {"wait": "levels"}, {"frames": 2}, {"picture": "p"}, {"wait": "complete"}]}"#;
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let shown = |lod: &str, error: &str| {
        let out = format!("{lod}-{error}");
        let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
        command.args(["fly", "--mask", "mask.nrrd", "--script", "s.json", "--frames-out", &out]);
        command.args(["--lod", lod, "--pixel-error", error]);
        let done = command.current_dir(tmp.path()).env_remove("INTIMA_FAULT").output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        intima::formats::read_png(&tmp.path().join(out).join("p.png")).unwrap().2
    };
    let apart = |a: &[u8], b: &[u8]| {
        assert_eq!(a.len(), b.len());
        let pairs = a.chunks(3).zip(b.chunks(3)).filter(|(a, b)| a != b);
        let most = |(a, b): (&[u8], &[u8])| {
            a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
        };
        (pairs.clone().count(), pairs.map(most).max().unwrap_or(0))
    };
    let whole = shown("off", "1");
    assert!(whole == shown("off", "100"), "the whole wall does not hang on the error");
    // On the crest of a fold front and back may have the same depth, and the back win.
    let (pixels, most) = apart(&whole, &shown("culled", "1"));
    assert!(pixels <= 20 && most < 64, "{pixels} pixels see what was left out, by {most}");
    assert!(whole != shown("vds", "8"), "a cut is drawn instead of the whole wall");
    let mut core = Command::new(env!("CARGO_BIN_EXE_intima"));
    core.args(["fly", "--mask", "mask.nrrd", "--core", "c.nrrd"]).current_dir(tmp.path());
    let done = core.args(["--script", "s.json", "--frames-out", "out"]).output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.code() == Some(2) && said.contains("--core is not for"), "{said}");
}

/// Without levels of detail the window drew the caps that `--open-ends` leaves out.
#[test]
fn an_open_end_is_open_in_the_window() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let inside = |i: usize| ((i % 20) as f64 - 9.5).hypot((i / 20 % 20) as f64 - 9.5) < 6.0;
    let voxels: Vec<u8> = (0..20 * 20 * 40).map(|i| u8::from(inside(i))).collect();
    let grid = intima::volume::Grid::axis_aligned([20, 20, 40], [1.0; 3]);
    let volume = intima::volume::Volume::new(grid, voxels.into());
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &volume).unwrap();
    let script = r#"{"schema": "intima.script/1", "size": [900, 600], "steps": [
        {"wait": "complete"}, {"do": {"seek": 10}}, {"frames": 2}, {"picture": "p"}]}"#;
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let shown = |out: &str, more: &[&str]| {
        let args = ["--script", "s.json", "--frames-out", out];
        let done = fly(tmp.path(), &[&args[..], &[], more].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        intima::formats::read_png(&tmp.path().join(out).join("p.png")).unwrap().2
    };
    let apart = |a: &[u8], b: &[u8]| a.chunks(3).zip(b.chunks(3)).filter(|(a, b)| a != b).count();
    let (closed, open) = (shown("closed", &[]), shown("open", &["--open-ends"]));
    assert!(apart(&closed, &open) > 1000, "{} pixels", apart(&closed, &open));
}

/// Plays a script of these steps with a session file; it succeeds.
fn play(dir: &Path, more: &[&str], steps: &str) {
    let script =
        format!(r#"{{"schema": "intima.script/1", "size": [640, 400], "steps": [{steps}]}}"#);
    std::fs::write(dir.join("s.json"), script).unwrap();
    let args = ["--script", "s.json", "--frames-out", "out", "--session", "notes.json"];
    let done = fly(dir, &[&args[..], &[], more].concat());
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
}

fn notes(dir: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(dir.join("notes.json")).unwrap()).unwrap()
}

#[test]
fn bookmarks_stay_when_another_lumen_of_the_volume_is_chosen() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let scan = Phantom::new(Kind::Bend, 48, [1.0; 3]).unwrap().grey(None, 0);
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &scan).unwrap();
    play(
        tmp.path(),
        &["--threshold", ":-500"],
        r#"{"wait": "complete"}, {"do": {"seek": 20}}, {"do": {"bookmark": "first"}},
        {"do": {"lumen": {"range": [-2000, -700]}}}, {"wait": "complete"},
        {"do": {"bookmark": "second"}}"#,
    );
    let texts: Vec<_> = notes(tmp.path())["bookmarks"]
        .as_array()
        .unwrap()
        .iter()
        .map(|b| (b["text"].as_str().unwrap().to_owned(), b["arc_mm"].is_null()))
        .collect();
    // The first is a place still, but none along the path that is gone.
    assert_eq!(texts, [("first".into(), true), ("second".into(), false)]);
}

/// The lumen had to be chosen again, and the eye, the colour and the branch were those of a new
/// window.
#[test]
fn a_session_closed_and_opened_without_options_is_the_same_to_the_pixel() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let scan = Phantom::new(Kind::Y, 48, [1.0; 3]).unwrap().grey(None, 0);
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &scan).unwrap();
    let picture = |n: &str| std::fs::read(tmp.path().join(format!("out/{n}.png"))).unwrap();
    play(
        tmp.path(),
        &[],
        r#"{"wait": "failure"}, {"picture": "asked"},
        {"do": {"lumen": {"range": [-2000, -500]}}}, {"wait": "complete"}, {"wait": "levels"},
        {"do": {"branch": 1}}, {"do": {"seek": 25}}, {"do": {"colour": "radius"}},
        {"do": {"opacity": 1.6}}, {"do": {"orbit": [0.6, -0.3]}}, {"do": {"extent": {"mm": 60}}},
        {"do": {"turn": [0.5, 0.2, 0.1]}}, {"do": {"fly": [0.5, 0.5, 0.5]}},
        {"do": {"bookmark": "here"}}, {"picture": "closed"}, {"do": {"export": "view"}}"#,
    );
    let json = notes(tmp.path());
    assert!(json["view"]["eye"].is_object() && json["lumen"]["range"].is_object(), "{json}");
    play(
        tmp.path(),
        &[],
        r#"{"wait": "complete"}, {"wait": "levels"}, {"frames": 2}, {"picture": "opened"},
        {"do": {"export": "view"}}"#,
    );
    assert!(picture("mask-view-1") == picture("mask-view-2"), "the inside view");
    assert_ne!(picture("asked"), picture("closed"));
    let again = notes(tmp.path());
    assert_eq!((&json["view"], &json["lumen"]), (&again["view"], &again["lumen"]));
}

#[test]
fn a_session_is_opened_in_a_window_of_its_volume_and_another_file_changes_nothing() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    play(
        tmp.path(),
        &[],
        r#"{"wait": "complete"}, {"wait": "levels"}, {"do": {"seek": 20}},
        {"do": {"colour": "radius"}}, {"do": {"turn": [0.5, 0.2, 0.1]}}, {"frames": 2},
        {"do": {"export": "view"}}"#,
    );
    let script = r#"{"schema": "intima.script/1", "size": [640, 400], "steps": [
        {"wait": "complete"}, {"wait": "levels"}, {"do": {"open_session": "notes.json"}},
        {"frames": 3}, {"do": {"export": "view"}}, {"do": {"open_session": "o.json"}},
        {"frames": 2}, {"do": {"export": "view"}}]}"#;
    std::fs::write(tmp.path().join("o.json"), script).unwrap();
    let args = ["--script", "o.json", "--frames-out", "out"];
    let done = fly(tmp.path(), &args);
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success() && said.contains("o.json: no session file"), "{said}");
    let view = |i: u32| std::fs::read(tmp.path().join(format!("out/mask-view-{i}.png"))).unwrap();
    assert!(view(1) == view(2) && view(2) == view(3));
}

#[test]
fn a_session_begins_at_the_place_on_the_path_where_it_ended() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let view = |i: u32| std::fs::read(tmp.path().join(format!("out/mask-view-{i}.png"))).unwrap();
    play(
        tmp.path(),
        &[],
        r#"{"wait": "complete"}, {"do": {"export": "view"}}, {"do": {"seek": 20}},
        {"do": {"export": "view"}}"#,
    );
    assert_eq!(notes(tmp.path())["arc_mm"], 20.0);
    // Also where it ends before the path is known.
    play(tmp.path(), &[], r#"{"wait": "distance"}"#);
    play(tmp.path(), &[], r#"{"wait": "complete"}, {"do": {"export": "view"}}"#);
    assert!(view(3) == view(2) && view(3) != view(1));
}

/// Plays a script without a volume or a session file of its own; what the program says.
fn play_alone(dir: &Path, args: &[&str], steps: &str) -> String {
    let script =
        format!(r#"{{"schema": "intima.script/1", "size": [900, 600], "steps": [{steps}]}}"#);
    std::fs::write(dir.join("s.json"), script).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
    command.args(["-v", "fly", "--script", "s.json", "--frames-out", "out"]).args(args);
    let done = command.current_dir(dir).env_remove("INTIMA_FAULT").output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(done.status.success(), "{said}");
    said
}

/// The window asked for a lumen, showed no finding, and the file held no way to its volume.
#[test]
fn a_session_file_alone_opens_its_volume_and_a_lumen_that_no_window_can_choose() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let scan = Phantom::new(Kind::Bend, 48, [1.0; 3]).unwrap().grey(None, 0);
    std::fs::create_dir(tmp.path().join("case")).unwrap();
    intima::formats::write_volume(&tmp.path().join("case/ct.nrrd"), &scan).unwrap();
    play_alone(
        tmp.path(),
        &["case/ct.nrrd", "--threshold", ":-500", "--no-fill", "--session", "case/s.json"],
        r#"{"wait": "complete"}, {"do": {"seek": 20}}, {"do": {"bookmark": "here"}},
        {"do": {"export": "view"}}"#,
    );
    std::fs::rename(tmp.path().join("case"), tmp.path().join("moved")).unwrap();
    let steps = r#"{"do": {"open_session": "moved/s.json"}}, {"wait": "complete"},
        {"do": {"export": "view"}}, {"do": {"bookmark": "again"}}"#;
    play_alone(tmp.path(), &[], steps);
    let view = |i: u32| std::fs::read(tmp.path().join(format!("out/ct-view-{i}.png"))).unwrap();
    assert!(view(1) == view(2), "the place of the session");
    let json = std::fs::read(tmp.path().join("moved/s.json")).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
    let texts: Vec<_> = json["bookmarks"].as_array().unwrap().iter().map(|b| &b["text"]).collect();
    assert_eq!(texts, ["here", "again"], "saved where it was opened");
    assert_eq!(json["lumen"]["settings"]["range"], serde_json::json!([null, -500.0]));
    assert_eq!(json["case"]["image"]["path"], "ct.nrrd");
    // Without its volume, the reason is said and nothing is lost.
    std::fs::remove_file(tmp.path().join("moved/ct.nrrd")).unwrap();
    let said = play_alone(tmp.path(), &[], r#"{"do": {"open_session": "moved/s.json"}}"#);
    assert!(said.contains("s.json: its volume is not there: ct.nrrd"), "{said}");
}

#[test]
fn the_window_is_exported_as_it_is_seen_with_findings_as_a_table() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    play_alone(
        tmp.path(),
        &["mask.nrrd"],
        r#"{"wait": "complete"}, {"wait": "levels"}, {"do": {"bookmark": "fold, \"high\""}},
        {"do": {"measure": "length"}}, {"do": {"mark": [10, 20, 30]}},
        {"do": {"mark": [10, 20, 37]}}, {"frames": 2}, {"picture": "seen"},
        {"do": {"export": "window"}}, {"do": {"export": "findings"}}"#,
    );
    let read = |name: &str| intima::formats::read_png(&tmp.path().join(name)).unwrap();
    assert!(read("out/seen.png") == read("out/mask-window-1.png"));
    let table = std::fs::read_to_string(tmp.path().join("out/mask-findings-1.csv")).unwrap();
    assert!(table.contains("\r\n1,\"fold, \"\"high\"\"\",,0.00,"), "{table}");
}

#[test]
fn notes_of_no_file_are_kept_offered_and_taken_with_their_pictures() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let args = ["mask.nrrd", "--state", "state"];
    let kept = || {
        let cases = std::fs::read_dir(tmp.path().join("state/cases")).unwrap();
        let paths = cases.map(|e| e.unwrap().path());
        let mut files: Vec<_> =
            paths.filter(|p| p.extension().is_some_and(|e| e == "json")).collect();
        assert_eq!(files.len(), 1, "one volume: {files:?}");
        files.remove(0)
    };
    let texts = |file: &Path| -> Vec<String> {
        let json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
        let bookmarks = json["bookmarks"].as_array().unwrap().clone();
        bookmarks.iter().map(|b| b["text"].as_str().unwrap().to_owned()).collect()
    };
    play_alone(tmp.path(), &args, r#"{"wait": "complete"}, {"do": {"bookmark": "first"}}"#);
    // Nobody answers: both are kept.
    play_alone(
        tmp.path(),
        &args,
        r#"{"wait": "complete"}, {"do": {"bookmark": "second"}}, {"picture": "offer"}"#,
    );
    assert_eq!(texts(&kept()), ["second", "first"]);
    play_alone(
        tmp.path(),
        &args,
        r#"{"wait": "complete"}, {"frames": 1}, {"do": "take_kept"},
        {"do": {"save_as": "mine.json"}}"#,
    );
    assert_eq!(texts(&tmp.path().join("mine.json")), ["second", "first"]);
    for i in [1, 2] {
        assert!(tmp.path().join(format!("mine-bookmark-{i}.png")).exists());
    }
    // The case is opened by its kept file alone, from anywhere.
    let file = kept();
    let steps = format!(
        r#"{{"do": {{"open_kept": {file:?}}}}}, {{"wait": "complete"}},
        {{"do": {{"bookmark": "third"}}}}"#
    );
    play_alone(tmp.path(), &["--state", "state"], &steps);
    assert_eq!(texts(&file), ["second", "first", "third"]);
    // Left, they are set aside.
    let steps = r#"{"wait": "complete"}, {"frames": 1}, {"do": "leave_kept"}, {"frames": 1}"#;
    play_alone(tmp.path(), &args, steps);
    assert!(texts(&kept()).is_empty());
    let aside = kept().with_extension("1.aside");
    assert_eq!(texts(&aside), ["second", "first", "third"]);
}

#[test]
fn notes_made_without_a_session_file_are_saved_as_one_with_their_pictures() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let script = r#"{"schema": "intima.script/1", "size": [640, 400], "steps": [
        {"wait": "complete"}, {"do": {"bookmark": "first"}}, {"do": {"save_as": "notes.json"}},
        {"do": {"bookmark": "second"}}, {"do": "quit"}]}"#;
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let args = ["--script", "s.json", "--frames-out", "out"];
    let done = fly(tmp.path(), &args);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let names = ["notes-bookmark-1.png", "notes-bookmark-2.png"];
    for (i, name) in names.into_iter().enumerate() {
        assert_eq!(notes(tmp.path())["bookmarks"][i]["picture"], name);
        assert!(tmp.path().join(name).exists());
    }
}

#[test]
fn a_series_a_segment_and_an_organ_are_chosen_in_the_window() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    std::fs::create_dir(tmp.path().join("scan")).unwrap();
    for (series, columns) in [("1.2.3", 4u16), ("1.2.4", 6)] {
        for z in 0..3u8 {
            let slice = volumes::Slice {
                series,
                size: [columns, 3],
                position: [0.0, 0.0, f64::from(z)],
                pixels: (0..columns * 3).map(|p| p * 90).collect(),
                ..volumes::Slice::default()
            };
            let file = tmp.path().join(format!("scan/{series}-{z}.dcm"));
            std::fs::write(file, volumes::dicom_slice(&slice)).unwrap();
        }
    }
    let seg = volumes::fixture("seg/layers.seg.nrrd");
    std::fs::copy(seg, tmp.path().join("a.seg.nrrd")).unwrap();
    let torso = torso::Torso::default().scan();
    intima::formats::write_volume(&tmp.path().join("torso.nrrd"), &torso).unwrap();
    let script = r#"{"schema": "intima.script/1", "size": [640, 400], "steps": [
        {"do": {"open": "scan"}}, {"wait": "failure"}, {"picture": "two_series"},
        {"do": {"series": 1}}, {"wait": "volume"}, {"picture": "series"},
        {"do": {"open": "a.seg.nrrd"}}, {"wait": "failure"}, {"picture": "segments"},
        {"do": {"segment": "Lumen"}}, {"wait": "wall"}, {"picture": "segment"},
        {"do": {"open": "torso.nrrd"}}, {"wait": "failure"}, {"picture": "no_lumen"},
        {"do": {"organ": "vessel"}}, {"wait": "wall"}, {"picture": "aorta"}]}"#;
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
    command.args(["fly", "--script", "s.json", "--frames-out", "out"]);
    let done = command.current_dir(tmp.path()).env_remove("INTIMA_FAULT").output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let names = ["two_series", "series", "segments", "segment", "no_lumen", "aorta"];
    let read = |n: &str| std::fs::read(tmp.path().join("out").join(format!("{n}.png"))).unwrap();
    let pictures = names.map(read);
    for w in pictures.windows(2) {
        assert_ne!(w[0], w[1]);
    }
    if let Some(out) = std::env::var_os("INTIMA_OUT") {
        for (name, picture) in names.iter().zip(&pictures) {
            std::fs::write(std::path::Path::new(&out).join(format!("{name}.png")), picture)
                .unwrap();
        }
    }
}

#[test]
fn without_a_display_or_with_a_wrong_script_a_clear_line_and_a_code_of_its_own() {
    let tmp = folder();
    let line = |o: &Output| String::from_utf8_lossy(&o.stderr).trim().to_owned();
    let none = fly(tmp.path(), &[]);
    assert_eq!((none.status.code(), line(&none).lines().count()), (Some(4), 1), "{}", line(&none));
    assert_eq!(line(&none), "intima: no display: neither X11 nor Wayland answers");
    std::fs::write(
        tmp.path().join("s.json"),
        r#"{"schema": "intima.script/1", "steps": [{"leap": 1}]}"#,
    )
    .unwrap();
    let wrong = fly(tmp.path(), &["--script", "s.json", "--frames-out", "o"]);
    assert_eq!(wrong.status.code(), Some(3));
    assert_eq!(line(&wrong), "intima: step 1 of the script: no step that there is");
    assert!(!tmp.path().join("o").exists());
}
