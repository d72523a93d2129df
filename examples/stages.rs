//! Single products of a session: `cargo run --release --example stages -- LABEL_MAP`.

use intima::session::stages::STAGES;
use intima::session::{Session, Settings, Source, VolumeSource};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let volume = std::env::args().nth(1).ok_or("usage: stages LABEL_MAP")?;
    let session = Session::new(Source::Image(VolumeSource::file(volume)), Settings::default())?;
    for stage in STAGES.iter().filter(|s| (s.when)(session.settings())) {
        println!("{:<12} needs {:?}", format!("{:?}", stage.product), stage.needs);
    }
    let lumen = session.lumen()?;
    println!("lumen: {:.1} ml", lumen.lumen.volume_ml());
    let distance = session.distance()?;
    println!("deepest: {:.2} mm", distance.iter().copied().fold(0.0, f32::max));
    let centerline = session.centerline()?;
    println!("centerline: {:.1} mm", centerline.line.length_mm());
    let wall = session.wall()?;
    println!("wall: {} faces, {:.0} mm²", wall.mesh.faces.len(), wall.mesh.area_mm2());
    for stage in &session.clock().stages {
        println!("{:<18} {:>8.1} ms on {}", stage.name, stage.ms, stage.device);
    }
    Ok(())
}
