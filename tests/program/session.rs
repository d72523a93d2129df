//! The session: products once, on request; progress; cancellation; sharing.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use glam::DVec3;
use intima::device::DeviceChoice;
use intima::flight::Frames;
use intima::geometry::{Camera, Vertex, point_triangle_distance};
use intima::lod::DrawnWall;
use intima::lumen::IntensitySelection;
use intima::organ::Organ;
use intima::render::View;
use intima::session::{
    Antialiasing, CenterlineReport, CenterlineSettings, EndPoint, FlightRoute, LevelSettings, Lod,
    LumenSettings, Mode, Product, Recording, Session, SessionError, Settings, Source, VolumeSource,
    WallForm, WallMethod,
};
use intima::surface::{Fairing, Smoothing};
use intima::volume::phantom::{Kind, Phantom};
use intima::volume::{Grid, Samples, Volume};

fn phantom(kind: Kind, size: u32) -> Arc<Volume> {
    Arc::new(Phantom::new(kind, size, [1.0; 3]).unwrap().mask())
}

fn session(volume: &Arc<Volume>, settings: Settings) -> Session {
    Session::new(Source::Image(VolumeSource::Memory(Arc::clone(volume))), settings).unwrap()
}

/// Settings under which the wall is subdivided.
fn subdivided() -> Settings {
    let levels = LevelSettings { lod: Lod::Vds, ..LevelSettings::default() };
    Settings { levels, ..Settings::default() }
}

#[test]
fn a_product_is_computed_once() {
    let session = session(&phantom(Kind::Bend, 48), Settings::default());
    let first = session.centerline().unwrap();
    let stages = session.clock().stages.len();
    assert!(Arc::ptr_eq(&first, &session.centerline().unwrap()));
    assert_eq!(session.clock().stages.len(), stages, "nothing ran again");
}

#[test]
fn threads_that_ask_at_once_get_the_same_product() {
    let session = session(&phantom(Kind::Bend, 48), Settings::default());
    let (a, b) = std::thread::scope(|scope| {
        let a = scope.spawn(|| session.wall().unwrap());
        let b = scope.spawn(|| session.wall().unwrap());
        (a.join().unwrap(), b.join().unwrap())
    });
    assert!(Arc::ptr_eq(&a, &b));
    let walls = session.clock().stages.iter().filter(|s| s.name == "surface").count();
    assert_eq!(walls, 1);
}

#[test]
fn what_depends_on_a_forgotten_product_is_computed_anew() {
    let mut session = session(&phantom(Kind::Bend, 48), Settings::default());
    let (line, wall) = (session.centerline().unwrap(), session.wall().unwrap());
    session.forget(&[Product::Fields]);
    assert!(!Arc::ptr_eq(&line, &session.centerline().unwrap()));
    assert!(Arc::ptr_eq(&wall, &session.wall().unwrap()), "the wall needs no fields");
}

#[test]
fn another_threshold_forgets_the_lumen_and_reads_no_volume() {
    let tmp = tempfile::tempdir().unwrap();
    let file = tmp.path().join("ct.nrrd");
    let scan = Phantom::new(Kind::Bend, 32, [1.0; 3]).unwrap().grey(None, 0);
    intima::formats::write_volume(&file, &scan).unwrap();
    let range = |hi| Some(IntensitySelection::Range { lo: -2000.0, hi });
    let mut settings = Settings::default();
    settings.lumen.select = range(-500.0);
    let source = Source::Image(VolumeSource::file(&file));
    let mut session = Session::new(source, settings.clone()).unwrap();
    session.keep_volume();
    let woken = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&woken);
    session.wake_by(move || {
        count.fetch_add(1, Ordering::Relaxed);
    });
    let wanted = [Product::Volume, Product::Lumen, Product::Wall, Product::Flight];
    assert!(session.products(&wanted).wall.is_none(), "nothing is there before it is asked for");
    session.prepare(&wanted).unwrap();
    let before = session.products(&wanted);
    let first = woken.load(Ordering::Relaxed);
    let made = Product::ALL.iter().filter(|p| session.products(&[**p]).has(**p)).count();
    assert_eq!(first, made, "woken once for each product");
    // It is not there to be read again.
    std::fs::remove_file(&file).unwrap();
    settings.lumen.select = range(-900.0);
    session.apply(settings).unwrap();
    let after = session.products(&wanted);
    assert!(Arc::ptr_eq(before.volume().unwrap(), after.volume().unwrap()));
    assert!(after.lumen.is_none() && after.wall.is_none() && after.flight.is_none());
    session.prepare(&wanted).unwrap();
    assert_eq!(Some(&session.lumen().unwrap().options.selection), range(-900.0).as_ref());
}

/// The hash was taken for the report after the last frame, and kept the volume until then.
#[test]
fn the_volume_is_read_once_and_dropped_when_its_last_reader_ends() {
    let tmp = tempfile::tempdir().unwrap();
    let file = tmp.path().join("ct.nrrd");
    let scan = Phantom::new(Kind::Bend, 32, [1.0; 3]).unwrap().grey(None, 0);
    intima::formats::write_volume(&file, &scan).unwrap();
    let mut settings = Settings::default();
    settings.lumen.select = Some(IntensitySelection::Range { lo: -2000.0, hi: -500.0 });
    let session = Session::new(Source::Image(VolumeSource::file(&file)), settings).unwrap();
    session.prepare(&[Product::Inputs, Product::Wall, Product::Flight]).unwrap();
    assert!(session.products(&[Product::Volume]).volume().is_none(), "kept");
    let reads = || session.clock().stages.iter().filter(|s| s.name == "read").count();
    assert_eq!(reads(), 1, "it was dropped in the middle of a plan and read again");
    session.prepare(&[Product::ValueRange]).unwrap();
    assert_eq!(reads(), 2);
}

#[test]
fn changed_settings_forget_exactly_the_products_that_depend_on_them() {
    use Product as P;
    let volume = phantom(Kind::Bend, 32);
    let settings = Settings { device: DeviceChoice::Cpu, ..subdivided() };
    // A renderer needs Vulkan, and a label map has nothing behind its wall.
    let is_made = |p: &Product| ![P::Display, P::Behind].contains(p);
    let all: Vec<Product> = P::ALL.iter().copied().filter(is_made).collect();
    let mut session = session(&volume, settings.clone());
    session.keep_volume();
    let mut forgotten = |change: fn(&mut Settings)| {
        session.apply(settings.clone()).unwrap();
        session.prepare(&all).unwrap();
        let mut changed = settings.clone();
        change(&mut changed);
        session.apply(changed).unwrap();
        let there = session.products(&all);
        all.iter().copied().filter(|p| !there.has(*p)).collect::<Vec<_>>()
    };
    let of_the_volume = [P::Volume, P::Device, P::Identity, P::ValueRange, P::Inputs];
    let below = |kept: &[Product]| -> Vec<Product> {
        all.iter().copied().filter(|p| !kept.contains(p)).collect()
    };
    assert_eq!(forgotten(|_| ()), []);
    assert_eq!(forgotten(|s| s.max_memory_mb = Some(1)), [], "a limit makes nothing otherwise");
    let labels = |s: &mut Settings| s.lumen.select = Some(IntensitySelection::Labels(vec![1]));
    assert_eq!(forgotten(labels), below(&of_the_volume));
    assert_eq!(forgotten(|s| s.lumen.organ = Some(Organ::Colon.into())), below(&of_the_volume));
    let of_the_flight = [P::Flight, P::Coverage, P::Sections];
    let reversed = forgotten(|s| s.flight.reverse = true);
    assert_eq!(reversed, [&of_the_flight[..], &[P::LumenProfile]].concat());
    assert_eq!(forgotten(|s| s.flight.fov_y_rad = 1.0), of_the_flight, "gaze");
    assert_eq!(forgotten(|s| s.wall.base_faces = Some(9)), [P::Base]);
    assert_eq!(forgotten(|s| s.levels.pixel_error = 9.0), [P::Levels]);
    let without_levels = forgotten(|s| s.levels.lod = Lod::Off);
    let of_what_is_drawn = [P::Levels, P::Flight, P::Coverage, P::Sections];
    assert_eq!(without_levels, of_what_is_drawn, "a flight keeps away from it");
    let of_the_path = [P::Route, P::Visibility, P::Centerline, P::Flight, P::Coverage, P::Sections];
    let tree = forgotten(|s| s.centerline.tree = true);
    assert_eq!(tree, [&of_the_path[..], &[P::LumenProfile, P::CenterlineDistances]].concat());
}

/// What a session makes of everything that settings change, as text.
fn figures(session: &Session) -> String {
    session.prepare(&[Product::Base, Product::Coverage, Product::Sections]).unwrap();
    let (lumen, wall, flight) =
        (session.lumen().unwrap(), session.wall().unwrap(), session.flight().unwrap());
    let (centered, fields) = (session.centerline().unwrap(), session.fields().unwrap());
    let levels = session.levels().map(|l| l.report.clone()).ok();
    let seen = &session.coverage().unwrap().seen_both_ways;
    let products: [&dyn std::fmt::Debug; 13] = [
        &session.lumen_profile().unwrap(),
        &lumen.lumen.inside_voxels(),
        &lumen.method,
        &wall.mesh,
        &&fields.distance[..],
        &fields.ridge.len(),
        &centered.line,
        &(centered.on_ridge, centered.candidates, centered.kept),
        &flight,
        &levels,
        &session.base().unwrap(),
        seen,
        &session.centerline_distances().unwrap(),
    ];
    products.iter().map(|product| format!("{product:?}\n")).collect()
}

#[test]
fn changed_settings_give_what_a_new_session_gives() {
    let volume = phantom(Kind::Y, 32);
    type Change = fn(&mut Settings);
    // Each is added to those before.
    let changes: [Change; 11] = [
        |s| s.flight.fov_y_rad = 1.2,
        |s| s.flight.view = View::Cube,
        |s| s.levels.pixel_error = 4.0,
        |s| s.wall.base_faces = Some(300),
        |s| s.centerline.tree = true,
        |s| s.flight.route = FlightRoute::All,
        |s| s.wall.smoothing = Some(Smoothing::Steps(Fairing::PAPER)),
        |s| s.lumen.wall = WallMethod::Exact,
        |s| s.levels.lod = Lod::Off,
        |s| s.lumen.fill = false,
        |s| *s = Settings { mode: Mode::Paper, ..Settings::default() },
    ];
    let mut settings = Settings { device: DeviceChoice::Cpu, ..subdivided() };
    let mut kept = session(&volume, settings.clone());
    let mut before = figures(&kept);
    for (i, change) in changes.into_iter().enumerate() {
        change(&mut settings);
        settings.device = DeviceChoice::Cpu;
        kept.apply(settings.clone()).unwrap();
        let now = figures(&kept);
        assert!(now == figures(&session(&volume, settings.clone())), "change {i}");
        assert!(now != before || i == 9, "change {i} changes nothing");
        before = now;
    }
}

#[test]
fn tree_and_grid_of_the_wall_are_built_once_for_all_who_ask() {
    let mut session = session(&phantom(Kind::Bend, 48), subdivided());
    let all = [Product::Levels, Product::Coverage, Product::Sections, Product::Inputs];
    let built = |session: &Session| {
        session.prepare(&all).unwrap();
        let flight = session.flight_along(FlightRoute::Trunk).unwrap();
        assert_eq!(session.sections_along(&flight).unwrap(), *session.sections().unwrap());
        session.unseen_csv().unwrap();
        let count = |name| session.clock().stages.iter().filter(|s| s.name == name).count();
        ["triangle tree", "outside"].map(count)
    };
    assert_eq!(built(&session), [1; 2]);
    let report = session.report(None).unwrap();
    assert_eq!(report.input.unwrap().hash, Some(session.identity().unwrap().to_string()));
    session.forget(&[Product::Wall]);
    assert_eq!(built(&session), [2; 2], "they are of the wall that was forgotten");
}

#[test]
fn a_released_volume_is_given_again_when_asked_for() {
    let session = session(&phantom(Kind::Bend, 32), Settings::default());
    session.prepare(&[Product::Lumen, Product::Wall, Product::Inputs]).unwrap();
    let (done, answer) = std::sync::mpsc::channel();
    std::thread::spawn(move || done.send(session.volume().is_ok()));
    assert_eq!(answer.recv_timeout(Duration::from_secs(60)), Ok(true));
}

/// Four samples took more of a run than all the rest of it where software draws.
#[test]
fn frames_have_four_samples_on_a_gpu_and_smoothed_edges_where_software_draws() {
    let Some(gpu) = common::gpu(intima::vk::Validate::Off) else { return };
    let volume = phantom(Kind::Bend, 48);
    let frames = |antialiasing| {
        let mut settings = Settings::default();
        settings.flight.frames = Frames::Count(2);
        settings.flight.size = [160, 120];
        settings.flight.antialiasing = antialiasing;
        let mut stream = session(&volume, settings).frames().unwrap();
        let next = || stream.next_frame().unwrap().map(|frame| frame.rgb);
        std::iter::from_fn(next).collect::<Vec<_>>()
    };
    let [auto, off, samples, edges] =
        [Antialiasing::Auto, Antialiasing::Off, Antialiasing::Samples, Antialiasing::Edges]
            .map(frames);
    assert!(auto == if gpu.info().is_real() { samples.clone() } else { edges.clone() });
    assert!(off != samples && off != edges && edges != samples);
}

#[test]
fn an_overview_and_a_wall_without_levels_are_drawn_whole() {
    let volume = phantom(Kind::Bend, 32);
    let mode = |change: fn(&mut Settings)| {
        let mut settings = Settings { device: DeviceChoice::Cpu, ..Settings::default() };
        change(&mut settings);
        session(&volume, settings).levels().unwrap().report.mode
    };
    assert_eq!(mode(|s| s.levels.lod = Lod::Off), "off");
    assert_eq!(mode(|s| s.flight.view = View::Overview), "off");
    assert_eq!(mode(|s| s.levels.lod = Lod::Culled), "culled");
    assert_eq!(mode(|s| s.mode = Mode::Paper), "culled");
    assert_eq!(mode(|_| ()), "refined");
}

/// The near plane of each pose against the triangles that its camera draws, refined ones too.
#[test]
fn no_near_plane_reaches_the_wall_as_it_is_drawn() {
    let mut refined = 0;
    for kind in [Kind::Bend, Kind::Y, Kind::Aneurysm] {
        let mut settings = Settings { device: DeviceChoice::Cpu, ..Settings::default() };
        settings.flight.frames = Frames::Count(40);
        let session = session(&phantom(kind, 48), settings);
        let (flight, levels) = (session.flight().unwrap(), session.levels().unwrap());
        let WallForm::Refined(wall) = &levels.form else { panic!("a refined wall") };
        let corner = |v: u32| wall.shading().vertices[v as usize];
        for i in 0..flight.poses.len() {
            let camera = Camera { pose: flight.poses[i], lens: flight.lens(i), height_px: 480 };
            let seen = wall.visible(&camera);
            refined += seen.refined.len();
            let flat = seen.ranges.iter();
            let flat = flat.flat_map(|r| r.first_index / 3..(r.first_index + r.indices) / 3);
            let flat = flat.map(|f| wall.faces()[f as usize].map(corner));
            let all = flat.chain(seen.refined.iter().flat_map(|f| wall.triangles(*f)));
            let eye = camera.pose.position_mm.as_dvec3();
            let away =
                |t: [Vertex; 3]| point_triangle_distance(eye, t.map(|v| v.position().as_dvec3()));
            let least = all.map(away).fold(f64::INFINITY, f64::min);
            let ball = f64::from(camera.lens.near_ball_mm());
            assert!(least > ball, "{kind:?} frame {i}: {least} mm, near ball {ball}");
        }
    }
    assert!(refined > 1000, "{refined}");
}

#[test]
fn products_are_the_same_at_every_number_of_threads() {
    let volume = phantom(Kind::Y, 64);
    let at = |threads| {
        let settings = Settings { threads: Some(threads), ..subdivided() };
        let session = session(&volume, settings);
        let base = session.base().unwrap();
        let wall = session.wall().unwrap();
        let csv = session.unseen_csv().unwrap();
        let line = session.centerline().unwrap().line.clone();
        (wall.mesh.clone(), (*base).clone(), csv, line)
    };
    let one = at(1);
    for threads in [2, 3, 8] {
        assert!(one == at(threads), "{threads} threads give another product");
    }
}

#[test]
fn a_cancelled_session_starts_no_further_stage_and_goes_on_after_a_reset() {
    let session = session(&phantom(Kind::Colon, 128), subdivided());
    let token = session.cancel_token();
    let outcome = std::thread::scope(|scope| {
        let work = scope.spawn(|| session.levels());
        while session.progress().stage.is_empty() && !work.is_finished() {
            std::thread::sleep(Duration::from_millis(1));
        }
        token.cancel();
        work.join().unwrap()
    });
    assert!(matches!(outcome, Err(SessionError::Cancelled)), "it was done before");
    assert!(session.clock().stages.iter().all(|s| s.name != "subdivision"));
    token.reset();
    assert!(session.lumen().is_ok());
}

#[test]
fn progress_reaches_its_end() {
    let session = session(&phantom(Kind::Bend, 48), Settings::default());
    assert_eq!(session.progress().share, 0.0);
    session.centerline().unwrap();
    assert!((session.progress().share - 1.0).abs() < 1e-3, "{:?}", session.progress());
    assert_eq!(session.progress().stage, "");
}

#[test]
fn the_paper_s_mode_shares_the_core_and_finds_another_line() {
    let session = session(&phantom(Kind::Bend, 48), Settings::default());
    let line = session.centerline().unwrap();
    let paper = session.in_mode(Mode::Paper);
    assert!(Arc::ptr_eq(&session.core().unwrap(), &paper.core().unwrap()));
    assert_ne!(line.line, paper.centerline().unwrap().line);
}

#[test]
fn points_in_a_filled_cavity_of_a_mask_are_told_apart() {
    let whole = phantom(Kind::Bend, 48);
    let points_in_cavities = |volume: &Arc<Volume>| {
        let session = session(volume, Settings::default());
        let report =
            CenterlineReport::of(&session.centerline().unwrap(), &session.lumen().unwrap());
        report.points_in_cavities
    };
    assert_eq!(points_in_cavities(&whole), 0);
    // A cavity about the middle of the path.
    let line = session(&whole, Settings::default()).centerline().unwrap();
    let points = &line.line.branches[0].points;
    let middle = points[points.len() / 2].position_mm;
    let labels: Vec<u8> = (0..whole.grid.len())
        .map(|i| {
            let at = whole.grid.world_from_voxel().transform_point3(whole.grid.voxel(i).as_dvec3());
            if at.distance(middle) < 1.8 { 0 } else { whole.real(i) as u8 }
        })
        .collect();
    let hollow = Arc::new(Volume::new(whole.grid, Samples::from(labels)));
    assert!((2..12).contains(&points_in_cavities(&hollow)));
}

#[test]
fn an_image_that_is_no_label_map_asks_how_the_lumen_is_chosen() {
    let ct = Arc::new(Phantom::new(Kind::Bend, 32, [1.0; 3]).unwrap().grey(None, 1));
    let outcome = session(&ct, Settings::default()).lumen();
    assert!(matches!(outcome, Err(SessionError::LumenNotChosen { .. })));
    let text = outcome.err().unwrap().to_string();
    assert!(!text.contains("--"), "a library names no flags: {text}");
}

#[test]
fn an_estimate_above_the_limit_is_refused_before_fields_are_made() {
    let volume = phantom(Kind::Colon, 64);
    let settings = Settings { max_memory_mb: Some(1), ..Settings::default() };
    let outcome = session(&volume, settings).wall();
    assert!(matches!(outcome, Err(SessionError::Memory { allowed_mb: 1, .. })));
}

#[test]
fn an_image_beside_a_mask_is_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let (image, mask) = (folder.path().join("ct.nrrd"), folder.path().join("mask.nrrd"));
    let volume = phantom(Kind::Bend, 32);
    intima::formats::write_volume(&mask, &volume).unwrap();
    intima::formats::write_volume(&image, &volume).unwrap();
    // The header stays; without its voxels the file cannot be read as a volume.
    let bytes = std::fs::read(&image).unwrap();
    let header = bytes.windows(2).position(|w| w == b"\n\n").unwrap() + 2;
    std::fs::write(&image, &bytes[..header + 100]).unwrap();
    assert!(intima::formats::read_volume(&image, &Default::default()).is_err());
    let source =
        Source::Mask { mask: VolumeSource::file(&mask), image: Some(VolumeSource::file(&image)) };
    let lumen = LumenSettings {
        select: Some(intima::lumen::IntensitySelection::Labels(vec![1])),
        ..Default::default()
    };
    let settings = Settings { lumen, ..Settings::default() };
    let outcome = Session::new(source, settings).unwrap().lumen();
    assert!(outcome.is_ok(), "{:?}", outcome.err());
}

#[test]
fn a_flight_of_any_length_draws_what_cameras_see_of_the_whole_wall() {
    if !crate::cli::can_draw() {
        return;
    }
    let volume = phantom(Kind::Bend, 32);
    let lod = |count: usize| {
        let mut settings = Settings { device: DeviceChoice::Cpu, ..Settings::default() };
        settings.flight.frames = Frames::Count(count);
        settings.flight.size = [32, 32];
        let session = session(&volume, settings);
        session.frames().unwrap().lod().clone()
    };
    let (short, long) = (lod(2), lod(2500));
    assert_eq!((short.mode, long.mode), ("refined", "refined"));
    assert_eq!(short.finest_faces, long.finest_faces);
}

/// A ball with thin, winding branches: voxels of 1 mm.
fn ball_with_branches() -> Arc<Volume> {
    const SIDE: usize = 128;
    let mut voxels = vec![0u8; SIDE * SIDE * SIDE];
    let middle = DVec3::splat(0.5 * SIDE as f64);
    let mut fill = |centre: DVec3, radius: f64| {
        let reach = DVec3::splat(radius);
        let (lo, hi) = ((centre - reach).as_usizevec3(), (centre + reach).as_usizevec3());
        for z in lo.z..=hi.z {
            for y in lo.y..=hi.y {
                for x in lo.x..=hi.x {
                    if centre.distance(DVec3::new(x as f64, y as f64, z as f64)) <= radius {
                        voxels[x + SIDE * (y + SIDE * z)] = 1;
                    }
                }
            }
        }
    };
    fill(middle, 14.0);
    for branch in 0..20 {
        // Evenly spread over the sphere.
        let height = (f64::from(branch) + 0.5) / 10.0 - 1.0;
        let turn = 2.4 * f64::from(branch);
        let around = (1.0 - height * height).sqrt();
        let out = DVec3::new(around * turn.cos(), around * turn.sin(), height);
        let (u, v) = out.any_orthonormal_pair();
        for step in 0..200 {
            let along = 12.0 + 0.22 * f64::from(step);
            let wave = 3.0 * ((0.2 * along).sin() * u + (0.27 * along).cos() * v);
            fill(middle + along * out + wave, 1.3);
        }
    }
    let grid = Grid::axis_aligned([SIDE as u32; 3], [1.0; 3]);
    Arc::new(Volume::new(grid, Samples::U8(voxels.into())))
}

#[test]
fn thin_branches_do_not_collapse_with_the_base_of_a_subdivision() {
    let volume = ball_with_branches();
    let levels = LevelSettings { lod: Lod::Vds, ..LevelSettings::default() };
    let session = session(&volume, Settings { levels, ..Settings::default() });
    let report = &session.levels().unwrap().report;
    // 15 mm where the base may lose branches.
    assert!(report.finest_error_mm.unwrap() < 2.0, "{report:?}");
}

#[test]
fn a_graph_with_an_end_by_name_is_there_after_the_fields_were_let_go() {
    let centerline = CenterlineSettings { from: Some(EndPoint::Root), ..Default::default() };
    let mut settings = Settings { centerline, ..Settings::default() };
    settings.flight.frames = Frames::Count(2);
    settings.flight.size = [64, 48];
    let session = session(&phantom(Kind::Y, 48), settings);
    let dir = tempfile::tempdir().unwrap();
    let frames = dir.path().join("frames");
    let recording = Recording { frames, release_products: true, ..Recording::default() };
    session.run_to_folder(dir.path(), &recording).unwrap();
    // The phantom has four tips.
    assert_eq!(session.graph().unwrap().tree().terminal_branches, 4);
}
