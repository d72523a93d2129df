//! The worker with scripted hierarchies.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use glam::{Quat, Vec3};

use super::*;
use crate::geometry::{Lens, Pose};
use crate::lod::{Upload, VisiblePatch};

/// A camera known by its number.
fn camera(number: u32) -> Camera {
    let pose = Pose { position_mm: Vec3::ZERO, rotation: Quat::IDENTITY };
    Camera { pose, lens: Lens { fov_y_rad: 1.0, aspect: 1.0, near_mm: 0.1 }, height_px: number }
}

/// Calls a closure with the camera's number and the number of the step, from 1.
struct Scripted<F> {
    steps: u32,
    script: F,
}

impl<F: FnMut(u32, u32) -> LodStep + Send> LodHierarchy for Scripted<F> {
    fn step(&mut self, camera: &Camera, _: &Tolerance, _: &mut PageCache) -> LodStep {
        self.steps += 1;
        (self.script)(camera.height_px, self.steps)
    }
    fn state_hash(&self) -> u64 {
        0
    }
    fn finest_faces(&self) -> u64 {
        42
    }
}

fn worker(script: impl FnMut(u32, u32) -> LodStep + Send + 'static) -> Worker {
    let refine = Box::new(Scripted { steps: 0, script });
    Worker::spawn(refine, Tolerance { pixels: 1.0 }, 8, 1 << 20, 3).unwrap()
}

/// A step that writes `page` with `number` triangles.
fn step_writing(page: u32, number: u32, settled: bool) -> LodStep {
    let triangles = vec![[0, 0, 0]; number as usize];
    let upload = Upload { page, vertices: Vec::new(), triangles };
    let drawn = VisiblePatch {
        page,
        resident: None,
        triangles: number,
        sphere: Default::default(),
        half: Default::default(),
        cone: Default::default(),
    };
    LodStep {
        uploads: vec![upload],
        drawn: vec![drawn],
        leaves_changed: 1,
        depths: None,
        settled,
        degraded: false,
    }
}

fn next(worker: &mut Worker) -> LodStep {
    for _ in 0..2000 {
        if let Some(step) = worker.try_recv().unwrap() {
            return step;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("no step came");
}

/// A script that reports each camera and then blocks until it is released.
fn gated() -> (Worker, Receiver<u32>, Sender<()>) {
    let (sender, receiver) = channel();
    let (go, wait) = channel();
    let w = worker(move |camera, step| {
        sender.send(camera).unwrap();
        wait.recv().unwrap();
        step_writing(0, step, true)
    });
    (w, receiver, go)
}

#[test]
fn only_the_newest_live_camera_is_processed() {
    let (mut w, receiver, go) = gated();
    w.set_camera(&camera(1));
    assert_eq!(receiver.recv().unwrap(), 1);
    for i in 2..=5 {
        w.set_camera(&camera(i));
    }
    go.send(()).unwrap();
    assert_eq!(receiver.recv().unwrap(), 5);
    go.send(()).unwrap();
    assert_eq!((next(&mut w).drawn[0].triangles, next(&mut w).drawn[0].triangles), (1, 2));
    // A settled camera is not processed again.
    w.set_camera(&camera(5));
    w.set_camera(&camera(6));
    assert_eq!(receiver.recv().unwrap(), 6);
    go.send(()).unwrap();
    assert_eq!(w.finest_faces(), 42);
}

#[test]
fn no_upload_is_lost_and_at_most_two_steps_are_queued() {
    let (sender, receiver) = channel();
    let mut w = worker(move |_, step| {
        sender.send(step).unwrap();
        step_writing(step % 8, step, step >= 10)
    });
    w.set_camera(&camera(1));
    assert_eq!((receiver.recv().unwrap(), receiver.recv().unwrap()), (1, 2));
    assert!(receiver.recv_timeout(Duration::from_millis(30)).is_err(), "a third step was made");
    let numbers: Vec<u32> = (0..5).map(|_| next(&mut w).drawn[0].triangles).collect();
    assert_eq!(numbers, [1, 2, 3, 4, 5]);
    // Queued live steps are part of the reply, in order.
    assert_eq!(receiver.iter().nth(4), Some(7));
    let step = w.converge(camera(1)).unwrap();
    let mut pages: Vec<_> = step.uploads.iter().map(|u| (u.page, u.triangles.len())).collect();
    pages.sort_unstable();
    assert_eq!(pages, [(0, 8), (1, 9), (2, 10), (6, 6), (7, 7)]);
    assert_eq!((step.drawn[0].triangles, step.leaves_changed, step.settled), (10, 5, true));
    assert_eq!(w.try_recv(), Ok(None));
}

#[test]
fn requests_are_served_in_order_and_merged_steps_write_each_page_once() {
    let mut w = worker(|camera, step| step_writing(step % 2, step, step % 4 == 0 || camera == 9));
    w.request(camera(1));
    w.request(camera(2));
    assert_eq!((w.outstanding(), w.try_recv()), (2, Ok(None)));
    let first = w.recv().unwrap();
    assert_eq!(first.uploads.iter().map(|u| u.triangles.len()).collect::<Vec<_>>(), [3, 4]);
    // The replies to the second and third request are merged.
    let both = w.converge(camera(9)).unwrap();
    assert_eq!(both.uploads.iter().map(|u| u.triangles.len()).collect::<Vec<_>>(), [9, 8]);
    assert_eq!((both.drawn[0].triangles, w.outstanding()), (9, 0));
}

#[test]
fn dropping_a_busy_worker_ends_its_thread() {
    for requested in [false, true] {
        let mut w = worker(|_, step| step_writing(step % 8, step % 100, false));
        if requested {
            w.request(camera(1))
        } else {
            w.set_camera(&camera(1))
        }
        std::thread::sleep(Duration::from_millis(5));
        drop(w);
    }
}

#[test]
fn a_panic_is_reported_after_all_earlier_steps() {
    let script = |_: u32, step: u32| {
        assert!(step < 2, "planted in step {step}");
        step_writing(0, step, false)
    };
    let planted = WorkerError::Panicked("planted in step 2".into());
    let mut live = worker(script);
    live.set_camera(&camera(1));
    assert_eq!(next(&mut live).drawn[0].triangles, 1);
    let end = (0..2000).find_map(|_| {
        std::thread::sleep(Duration::from_millis(1));
        live.try_recv().err()
    });
    assert_eq!(end, Some(planted.clone()));
    let mut capture = worker(script);
    capture.request(camera(1));
    assert_eq!(capture.converge(camera(2)), Err(planted.clone()));
    assert_eq!((capture.outstanding(), capture.try_recv()), (0, Err(planted)));
}

#[test]
fn a_cut_that_never_settles_is_an_error() {
    let mut w = worker(|_, _| LodStep::default());
    assert_eq!(w.converge(camera(1)), Err(WorkerError::Unsettled(1000)));
}
