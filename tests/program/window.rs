//! The window's model without a display: what it shows is what is there, and no move by hand takes the
//! eye's near plane through the wall.
#![cfg(feature = "window")]

use std::sync::Arc;

use common::cast::Cast;
use common::volumes;
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

#[test]
#[ignore = "minutes: cargo test --release --test program no_million_moves -- --ignored"]
fn no_million_moves_by_hand_take_the_near_plane_through_the_wall_of_a_real_colon() {
    let colon = shared("colon_label_1.nii.gz", IntensitySelection::Labels(vec![1]));
    colon.iter().for_each(|session| wander(session, 1_000_000));
}

/// A slide round a fold once ended where the straight way back cut the fold.
#[test]
#[ignore = "minutes: cargo test --release --test program no_million_moves -- --ignored"]
fn no_million_moves_by_hand_take_the_near_plane_through_the_wall_of_a_real_aorta() {
    let range = IntensitySelection::Range { lo: 1100.0, hi: f64::INFINITY };
    let aorta = shared("aorta_mra.mha", range);
    aorta.iter().for_each(|session| wander(session, 1_000_000));
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

/// The window had 2496 mm for a colon of 2695 mm in its report, and the places of missed patches hung on
/// the number of frames.
#[test]
fn a_path_has_one_length_in_window_profile_and_centerline_whatever_the_frames() {
    let session = session(Kind::Colon, 64);
    let model = model(&session);
    let line = session.centerline().unwrap();
    let length = line.line.length_mm();
    let shown = model.path.as_ref().unwrap().length_mm();
    assert!((shown - length).abs() < 1e-6, "{shown} and {length} mm");
    let profile = session.lumen_profile().unwrap().length_mm();
    assert!((profile - length).abs() < 1e-3, "{profile} and {length} mm");
    let arcs = |frames: usize| {
        let mut settings = session.settings().clone();
        settings.flight.frames = Frames::Count(frames);
        let mask = Phantom::new(Kind::Colon, 64, [1.0; 3]).unwrap().mask();
        let source = Source::Image(VolumeSource::Memory(Arc::new(mask)));
        let flight = Session::new(source, settings).unwrap().flight().unwrap();
        assert!(flight.arc_mm.is_sorted() && flight.arc_mm[0] == 0.0);
        flight.arc_mm.last().copied().unwrap()
    };
    assert!((arcs(7) - length).abs() < 1e-6 && (arcs(300) - length).abs() < 1e-6);
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
    let sections = session.sections_along(&flight).unwrap();
    model.take_branch(flight, &sections, route);
    assert!(tip(&model).distance(old) > 10.0, "another end");
    let moved = model.pose.unwrap().position_mm.distance(pose.position_mm);
    assert!(moved < 1.0, "the eye stays where the ways part: {moved}");
    // The way back is a choice now.
    assert!(model.choices.iter().any(|c| c.branch == 0), "{:?}", model.choices);
}
