//! From a file to frames: `cargo run --release --example fly -- LABEL_MAP FOLDER`.

use std::path::Path;

use intima::flight::Frames;
use intima::formats::write_png;
use intima::session::{FlightSettings, Session, Settings, Source, VolumeSource};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let (Some(volume), Some(folder)) = (args.next(), args.next()) else {
        return Err("usage: fly LABEL_MAP FOLDER".into());
    };
    std::fs::create_dir_all(&folder)?;
    let flight =
        FlightSettings { frames: Frames::Count(12), size: [320, 180], ..FlightSettings::default() };
    let settings = Settings { flight, ..Settings::default() };
    let session = Session::new(Source::Image(VolumeSource::file(volume)), settings)?;
    let mut frames = session.frames()?;
    while let Some(frame) = frames.next_frame()? {
        let name = format!("frame_{:05}.png", frame.index + 1);
        write_png(&Path::new(&folder).join(name), frame.size[0], frame.size[1], &frame.rgb)?;
    }
    let seen = session.coverage()?;
    println!("{} frames; {:.1} % of the wall seen", frames.count(), 100.0 * seen.one_way_fraction);
    Ok(())
}
