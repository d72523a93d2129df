//! Checks of a frame before anything of it is recorded. They hold in release builds too: what
//! passes them cannot make a driver read or write where it must not.

use super::Gpu;
use super::draw::{Draw, DrawRange, Pass};
use super::draw_pipeline::Blend;
use super::frame::{Frame, ImageWrite};
use super::ids::{BufferId, ImageId};
use super::resources::{Format, ImageSpec};

impl Gpu {
    /// Checks all of a frame.
    ///
    /// # Panics
    /// If a handle is stale or something does not fit: an error of the caller.
    pub(super) fn check_frame(&self, frame: &Frame<'_>) {
        for pass in &frame.passes {
            self.check_pass(pass);
            for draw in &pass.draws {
                self.check_targets(pass, draw);
                self.check_draw(draw);
            }
        }
        frame.image_writes.iter().for_each(|w| self.check_image_write(w));
        if let Some((from, to)) = frame.picture {
            self.check_picture(from, to);
        }
    }

    fn check_image_write(&self, write: &ImageWrite<'_>) {
        let image = self.spec(write.to);
        let writable = image.format != Format::Depth32 && image.samples == 1;
        assert!(writable, "a colour image of one sample a pixel");
        let a = write.area;
        let [width, height] = image.extent.map(u64::from);
        let [right, low] =
            [(a.x, a.width), (a.y, a.height)].map(|(x, n)| u64::from(x) + u64::from(n));
        assert!(a.width > 0 && a.height > 0 && right <= width && low <= height, "a part of it");
        let bytes = u64::from(a.width) * u64::from(a.height) * image.format.pixel_bytes();
        assert_eq!(write.bytes.len() as u64, bytes, "bytes of the pixels");
    }

    fn spec(&self, image: ImageId) -> ImageSpec {
        self.images[image].spec
    }

    /// Checks that the targets of a pass agree with each other, and that its area lies in all of
    /// them.
    fn check_pass(&self, pass: &Pass) {
        let colour = self.spec(pass.colour);
        assert!(colour.format != Format::Depth32, "a colour target holds colours");
        let area = pass.area;
        assert!(area.width > 0 && area.height > 0, "an area of no pixels");
        let targets = [Some(pass.colour), pass.resolve, pass.depth, pass.kept_depth];
        for image in targets.into_iter().flatten() {
            let [width, height] = self.spec(image).extent;
            let within =
                |from: u32, n: u32, side: u32| u64::from(from) + u64::from(n) <= side.into();
            let within = within(area.x, area.width, width) && within(area.y, area.height, height);
            assert!(within, "the area lies in every target");
        }
        if let Some(resolve) = pass.resolve.map(|r| self.spec(r)) {
            assert!(colour.samples > 1 && resolve.samples == 1, "several samples become one");
            assert_eq!(resolve.format, colour.format, "formats of a target and what it becomes");
            assert!(!pass.encoded, "encoded colours are not averaged");
        }
        if let Some(depth) = pass.depth.map(|d| self.spec(d)) {
            assert_eq!(depth.format, Format::Depth32, "a depth target");
            assert_eq!(depth.samples, colour.samples, "samples of colour and depth");
        }
        if let Some(kept) = pass.kept_depth.map(|d| self.spec(d)) {
            let is_kept = kept.format == Format::Depth32 && kept.samples == 1;
            let depth = pass.depth.map(|d| self.spec(d).samples);
            assert!(is_kept && depth.is_some_and(|n| n > 1), "several depths become one");
        }
        let stored = colour.format == Format::Rgba8Srgb && colour.samples == 1;
        assert!(!pass.encoded || stored, "an encoded target is stored as sRGB, one sample a pixel");
    }

    /// Checks that the pipeline of a draw was made for the targets of its pass, and that none of
    /// the images it reads is one of them.
    fn check_targets(&self, pass: &Pass, draw: &Draw) {
        let p = &self.draw_pipelines[draw.pipeline];
        let target = self.spec(pass.colour);
        let colour = if pass.encoded { Format::Rgba8Stored } else { target.format };
        assert_eq!(p.colour, colour, "colour format of pipeline and pass");
        let depth = pass.depth.map(|d| self.spec(d).format);
        assert_eq!(p.depth, depth, "depth format of pipeline and pass");
        assert_eq!(p.samples, target.samples, "samples of pipeline and pass");
        let replaces = p.blend == Blend::Opaque;
        assert!(!pass.encoded || replaces, "encoded colours are not blended");
        if let Some(s) = draw.scissor {
            let within = |from: u32, n: u32, low: u32, side: u32| {
                from >= low && u64::from(from) + u64::from(n) <= u64::from(low) + u64::from(side)
            };
            let a = pass.area;
            let fits = within(s.x, s.width, a.x, a.width) && within(s.y, s.height, a.y, a.height);
            assert!(fits, "the scissor lies in the area");
        }
        for image in &draw.images {
            let read = self.spec(*image);
            assert!(read.samples == 1, "an image to be read");
            let targets = [Some(pass.colour), pass.resolve, pass.depth, pass.kept_depth];
            let drawn_to = targets.contains(&Some(*image));
            assert!(!drawn_to, "a target is not read while it is drawn to");
        }
    }

    /// Checks that a draw fits its pipeline, and that all it reads is in its buffers.
    fn check_draw(&self, draw: &Draw) {
        let p = &self.draw_pipelines[draw.pipeline];
        assert_eq!(draw.push.len(), p.push_bytes as usize, "immediate block");
        assert_eq!(draw.images.len(), p.images as usize, "images");
        assert_eq!(draw.buffers.len(), p.buffers as usize, "buffers");
        let are_storage = draw.buffers.iter().all(|b| self.buffers[*b].is_storage);
        assert!(are_storage, "buffers that shaders may read");
        let bytes = |id: Option<BufferId>| id.map_or(0, |b| self.buffers[b].buffer.bytes);
        assert!(
            draw.vertices.is_none_or(|v| self.buffers[v].holds_vertices),
            "vertices lie in a vertex buffer"
        );
        let vertices = match p.stride {
            0 => u64::MAX,
            stride => bytes(draw.vertices) / u64::from(stride),
        };
        let index = draw.indices.map(|i| &self.buffers[i]);
        assert!(index.is_none_or(|i| i.holds_indices), "an index buffer");
        let last = index.map_or(0, |i| u64::from(i.max_index));
        // Whether indices from one on are in the buffer, and written.
        let room = index.map_or(0, |i| i.written.unwrap_or(i.buffer.bytes) / 4);
        let there = |first: u32, count: u32| u64::from(first) + u64::from(count) <= room;
        match (&draw.range, index) {
            (DrawRange::Direct(r), Some(_)) => {
                assert!(there(r.start, r.len() as u32), "index range");
                assert!(last < vertices, "index past vertices");
            }
            (DrawRange::Direct(r), None) => assert!(u64::from(r.end) <= vertices, "vertex range"),
            (DrawRange::Indirect(ranges), _) => {
                assert!(index.is_some(), "indirect draws have indices");
                for r in ranges {
                    assert!(there(r.first_index, r.indices), "index range");
                    let v = u64::from(r.first_vertex);
                    assert!(v <= i32::MAX as u64 && v + last < vertices, "index past vertices");
                }
            }
        }
    }

    /// Checks that the picture can be copied and fits the buffer it is copied to.
    fn check_picture(&self, from: ImageId, to: BufferId) {
        let picture = self.spec(from);
        let readable = picture.format != Format::Depth32 && picture.samples == 1;
        assert!(readable, "a colour image of one sample a pixel");
        let [width, height] = picture.extent.map(u64::from);
        let bytes = width * height * picture.format.pixel_bytes();
        let buffer = &self.buffers[to];
        assert!(buffer.reads_back, "a read-back buffer");
        assert!(bytes <= buffer.buffer.bytes, "room for the picture");
    }
}
