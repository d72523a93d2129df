//! `intima hessian`.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::CliError;
use super::global::{Global, VOLUMES};
use super::lumen_args::LumenArgs;
use super::repeat::{Timing, timed, timed_products};
use crate::compute::Array;
use crate::field::Response;
use crate::formats::{shown, write_vector_field, write_volume};
use crate::lumen::Lumen;
use crate::session::{Clock, HessianSettings, Product, Session, Settings, grey_hessian};
use crate::volume::{Grid, Samples, Volume};

/// `intima hessian INPUT [LUMEN] -o FIELD`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume; may be left out with --mask
    input: Option<PathBuf>,
    /// Field to write: .nrrd (one or three components), or any volume format for one
    #[arg(short, long, value_name = "FIELD")]
    output: PathBuf,
    /// Field to analyse: the exact distance in the lumen, or the grey values
    #[arg(long, value_enum, default_value = "distance")]
    of: Of,
    /// Gaussian before the derivatives, mm (default: the smallest voxel spacing)
    #[arg(long, value_name = "MM")]
    sigma: Option<f64>,
    /// Response of the eigenvalues l1 <= l2 <= l3
    #[arg(long, value_enum, default_value = "ridge")]
    response: Response,
    /// Look for dark ridges (air in grey values) instead of bright ones
    #[arg(long)]
    dark: bool,
    #[command(flatten)]
    lumen: LumenArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Of {
    Distance,
    Grey,
}

impl Args {
    /// Computes the response and writes it.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        let three = self.response == Response::Eigenvalues;
        global.check_output(&self.output, if three { &[".nrrd"] } else { VOLUMES })?;
        let l = &self.lumen;
        let grey = self.of == Of::Grey;
        if grey && (l.mask.is_some() || l.threshold.is_some()) {
            return Err(CliError::Usage(
                "--of grey analyses the whole volume: leave --mask and --threshold out".into(),
            ));
        }
        if grey && (l.core.is_some() || l.explain.is_some()) {
            let why = "--of grey chooses no lumen: leave --core and --explain out";
            return Err(CliError::Usage(why.into()));
        }
        l.check_outputs(global)?;
        let settings = Settings { lumen: l.settings()?, ..global.settings() };
        let mut session = Session::new(l.source(self.input.as_deref())?, settings)?;
        let (field, bricks, timing, settings, mut copied) = if grey {
            self.of_grey(global, &session)?
        } else {
            self.of_distance(global, &mut session)?
        };
        let (lumen, sigma, response) = (&*bricks, settings.sigma_mm, settings.response);
        let (grid, start) = (lumen.stored_grid(), Instant::now());
        if response == Response::Eigenvalues {
            let triples: &[[f32; 3]] = bytemuck::cast_slice(&field);
            let dense = lumen.dense(triples, [0.0; 3]);
            copied += start.elapsed();
            write_vector_field(&self.output, &grid, 3, bytemuck::cast_slice(&dense))?;
        } else {
            let dense = lumen.dense(&field, 0.0f32);
            copied += start.elapsed();
            write_volume(&self.output, &Volume::new(grid, Samples::from(dense)))?;
        }
        if !grey {
            l.write_choice(&session, global)?;
        }
        global.say(format_args!("wrote {} (sigma {sigma} mm)", shown(&self.output)))?;
        global.answer(&timing.with("sigma_mm", sigma).with("dense_s", copied.as_secs_f64()))
    }

    fn settings(&self, grid: &Grid) -> Result<HessianSettings, CliError> {
        let least = grid.spacing_mm.min_element();
        let sigma_mm = self.sigma.unwrap_or(least);
        if !(sigma_mm > 0.0 && sigma_mm <= 50.0 * least) {
            return Err(CliError::Usage(format!(
                "--sigma {sigma_mm}: between 0 and 50 voxels ({} mm)",
                50.0 * least
            )));
        }
        Ok(HessianSettings { sigma_mm, response: self.response, dark: self.dark })
    }

    /// Analyses the grey values of the whole volume; copying them into bricks is outside the clock.
    fn of_grey(&self, global: &Global, session: &Session) -> Result<HessianField, CliError> {
        let volume = global.watched(session, || session.volume())?;
        let settings = self.settings(&volume.grid)?;
        let start = Instant::now();
        let values = grey_hessian(&volume);
        let copied = start.elapsed();
        drop(volume);
        let device = session.device()?;
        let mut device = device.lock();
        let (field, timing) = timed(
            global,
            &mut *device,
            |d| Ok(d.name().to_owned()),
            |_| (),
            |d| {
                let mut clock = Clock::default();
                Ok((values.response(d, settings, &mut clock)?, clock))
            },
        )?;
        Ok((field, Arc::new(values.bricks), timing, settings, copied))
    }

    /// Analyses the distance field over the lumen.
    fn of_distance(
        &self,
        global: &Global,
        session: &mut Session,
    ) -> Result<HessianField, CliError> {
        global.watched(session, || session.lumen())?;
        let lumen = Arc::new(session.lumen()?.lumen.clone());
        let settings = self.settings(&lumen.grid)?;
        session.expect(&[Product::Fields]);
        let needs = [Product::Lumen, Product::Device];
        let (field, timing) =
            timed_products(global, session, &needs, &[], |s| Ok(s.distance_hessian(settings)?))?;
        Ok((field, lumen, timing, settings, Duration::ZERO))
    }
}

/// The field, the bricks it lies in, its timing and settings, and the time copying took.
type HessianField = (Array<f32>, Arc<Lumen>, Timing, HessianSettings, Duration);
