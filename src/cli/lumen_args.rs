//! Choosing the lumen: INPUT, `--mask`, `--threshold`, seeds.

use std::path::{Path, PathBuf};

use glam::{DVec3, UVec3};

use super::CliError;
use super::dicom_args::DicomArgs;
use super::global::{Global, MASKS, is_segments};
use crate::formats::{
    FormatError, ReadOptions, SegmentDescription, shown, write_png, write_segment, write_volume,
};
use crate::lumen::IntensitySelection;
use crate::organ::{self, Organ, OrganOptions};
use crate::session::{LumenSettings, Seed, Session, Source, VolumeSource, WallMethod};
use crate::volume::{Grid, Samples, Volume};

/// LUMEN flags.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Choosing the lumen")]
pub struct LumenArgs {
    /// Label map: FILE, FILE:LABEL or FILE:LABEL,LABEL…
    #[arg(long, value_name = "FILE[:LABEL…]", conflicts_with = "threshold")]
    pub mask: Option<PathBuf>,
    /// Inclusive range in HU or stored units after rescale; either side may be empty
    #[arg(long, value_name = "LO:HI", allow_hyphen_values = true)]
    pub threshold: Option<String>,
    /// Keep the component of this voxel (x fastest)
    #[arg(long, value_name = "I,J,K", conflicts_with = "seed_mm")]
    pub seed: Option<String>,
    /// Keep the component of the voxel at this point, LPS mm
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub seed_mm: Option<String>,
    /// Find this organ: threshold, seed and leak control are chosen
    #[arg(long, value_enum, value_name = "ORGAN")]
    #[arg(conflicts_with_all = ["mask", "threshold", "seed", "seed_mm", "all_components", "leak_control"])]
    pub organ: Option<Organ>,
    /// Take a colon's tagged fluid too, where there is some
    #[arg(long, requires = "organ")]
    pub tagged: bool,
    /// Leave a colon's tagged fluid out (the default)
    #[arg(long, requires = "organ", conflicts_with = "tagged")]
    pub no_tagged: bool,
    /// Take an airway's thin bronchi too, beyond the threshold of the tree (the default)
    #[arg(long, requires = "organ")]
    pub thin_bronchi: bool,
    /// Leave an airway's thin bronchi out
    #[arg(long, requires = "organ", conflicts_with = "thin_bronchi")]
    pub no_thin_bronchi: bool,
    /// Draw the segmented organ in projections of the volume, a PNG, and print the names of all gas and bright vessels
    #[arg(long, value_name = "FILE.png", requires = "organ")]
    pub explain: Option<PathBuf>,
    /// Keep every component
    #[arg(long)]
    pub all_components: bool,
    /// Leave closed cavities open
    #[arg(long)]
    pub no_fill: bool,
    /// Draw the threshold in to just below the first leak (needs a seed)
    #[arg(long)]
    pub leak_control: bool,
    /// Place of the wall
    #[arg(long, value_enum, default_value = "auto", value_name = "METHOD")]
    pub wall: WallMethod,
    /// Write the mask that the wall was drawn about: .nrrd, .nii.gz, .mha or .seg.nrrd
    #[arg(long, value_name = "FILE")]
    pub core: Option<PathBuf>,
    #[command(flatten)]
    pub dicom: DicomArgs,
}

impl LumenArgs {
    /// The volumes that the flags name.
    pub fn source(&self, input: Option<&Path>) -> Result<Source, CliError> {
        let volume = |path: &Path| VolumeSource::File {
            path: path.to_owned(),
            options: self.dicom.options(),
        };
        if let Some(spec) = &self.mask {
            let (path, labels) = split_labels(spec);
            if !labels.is_empty() && !self.dicom.segment.is_empty() {
                let why = "--segment and a label of --mask are two choices of the same thing";
                return Err(CliError::Usage(why.into()));
            }
            let mut options = self.dicom.options();
            if input.is_some() {
                (options.series, options.volume) = (None, None);
            }
            let mask = VolumeSource::File { path, options };
            let options = self.image_options();
            let image = |path: &Path| VolumeSource::File { path: path.to_owned(), options };
            return Ok(Source::Mask { mask, image: input.map(image) });
        }
        let input = input.ok_or_else(|| CliError::Usage("an INPUT or --mask is needed".into()))?;
        Ok(Source::Image(volume(input)))
    }

    /// Returns the options for reading INPUT beside a mask, whose segments are not its own.
    pub fn image_options(&self) -> ReadOptions {
        ReadOptions { segments: Vec::new(), ..self.dicom.options() }
    }

    /// Says which organ was found, and writes the core and the organ's projections where asked for.
    pub fn write_choice(&self, session: &Session, global: &Global) -> Result<(), CliError> {
        let lumen = session.lumen()?;
        if let Some(organ) = &lumen.organ {
            let pieces = organ.segments.len();
            global.say(format_args!(
                "{}: {:.0} ml in {pieces} piece{}, confidence {:.2}",
                organ.organ.name(),
                lumen.lumen.volume_ml(),
                if pieces == 1 { "" } else { "s" },
                organ.confidence
            ))?;
        }
        self.write_core(session, global)?;
        self.draw_organ(session, global)
    }

    /// Checks, before anything is computed, the names and folders of what [`Self::write_choice`]
    /// writes.
    pub fn check_outputs(&self, global: &Global) -> Result<(), CliError> {
        self.core.iter().try_for_each(|file| global.check_output(file, MASKS))?;
        self.explain.iter().try_for_each(|file| global.check_output(file, &[".png"]))
    }

    fn write_core(&self, session: &Session, global: &Global) -> Result<(), CliError> {
        let Some(file) = &self.core else { return Ok(()) };
        let (core, segmented) = (session.core()?, session.lumen()?);
        let (own, grid) = (segmented.lumen.volume_grid(), segmented.lumen.stored_grid());
        let mut voxels = vec![0u8; grid.len()];
        for v in core.voxels().voxels() {
            voxels[grid.index(own.stored_voxel(v.as_ivec3()).as_uvec3())] = 1;
        }
        write_mask(file, &grid, voxels, &segmented.description())?;
        global.say(format_args!("wrote {}", shown(file)))
    }

    fn draw_organ(&self, session: &Session, global: &Global) -> Result<(), CliError> {
        let Some(file) = &self.explain else { return Ok(()) };
        let (volume, segmented) = (session.volume()?, session.lumen()?);
        let seeds: Vec<UVec3> =
            segmented.organ.iter().flat_map(|o| &o.segments).map(|s| s.seed).collect();
        let (width, height, rgb) = organ::explain(&volume, &segmented.lumen, &seeds);
        write_png(file, width, height, &rgb)?;
        for line in organ::named_components(&volume) {
            global.say(line)?;
        }
        global.say(format_args!("wrote {}", shown(file)))
    }

    /// Returns the settings by which the lumen is chosen.
    pub fn settings(&self) -> Result<LumenSettings, CliError> {
        let select = match (&self.mask, &self.threshold) {
            (Some(spec), _) => Some(IntensitySelection::Labels(split_labels(spec).1)),
            (None, Some(threshold)) => Some(parse_threshold(threshold)?),
            (None, None) => None,
        };
        let seed = match (&self.seed, &self.seed_mm) {
            (Some(s), _) => {
                let [i, j, k] = numbers::<i64>(s, "--seed", "I,J,K")?;
                let v = [i, j, k].map(|n| u32::try_from(n).unwrap_or(u32::MAX));
                Some(Seed::Voxel(UVec3::from(v)))
            }
            (None, Some(s)) => Some(Seed::Point(point(s, "--seed-mm")?)),
            (None, None) => None,
        };
        for (flag, is_given, name, organ) in [
            ("--tagged", self.tagged, "colon", Organ::Colon),
            ("--no-tagged", self.no_tagged, "colon", Organ::Colon),
            ("--thin-bronchi", self.thin_bronchi, "airway", Organ::Airway),
            ("--no-thin-bronchi", self.no_thin_bronchi, "airway", Organ::Airway),
        ] {
            if is_given && self.organ != Some(organ) {
                return Err(CliError::Usage(format!("{flag} needs --organ {name}")));
            }
        }
        let (tagged, thin) = (self.tagged, !self.no_thin_bronchi);
        let organ = self.organ.map(|organ| OrganOptions { organ, tagged, thin });
        Ok(LumenSettings {
            organ,
            select,
            seed,
            all_components: self.all_components,
            fill: !self.no_fill,
            leak_control: self.leak_control,
            wall: self.wall,
        })
    }
}

/// Whether a volume in this file is written some slices at a time, so that nobody holds all of it.
pub fn is_layered(file: &Path) -> bool {
    file.to_string_lossy().to_lowercase().ends_with(".nrrd") && !is_segments(file)
}

/// Writes labels of a mask as a volume, or as a segment where the file holds segments.
pub fn write_mask(
    file: &Path,
    grid: &Grid,
    labels: Vec<u8>,
    segment: &SegmentDescription,
) -> Result<(), FormatError> {
    match is_segments(file) {
        true => write_segment(file, grid, &labels, segment),
        false => write_volume(file, &Volume::new(*grid, Samples::from(labels))),
    }
}

/// `FILE:1,2` into path and labels; a path that exists as it stands has no labels.
pub fn split_labels(spec: &Path) -> (PathBuf, Vec<i64>) {
    if spec.exists() {
        return (spec.into(), Vec::new());
    }
    let labels = spec.to_str().and_then(|spec| spec.rsplit_once(':')).and_then(|(path, labels)| {
        let labels: Option<Vec<i64>> = labels.split(',').map(|l| l.trim().parse().ok()).collect();
        Some((PathBuf::from(path), labels?))
    });
    labels.unwrap_or_else(|| (spec.into(), Vec::new()))
}

/// `LO:HI`, either side empty.
pub fn parse_threshold(text: &str) -> Result<IntensitySelection, CliError> {
    let bad = |why: &str| {
        CliError::Usage(format!("--threshold `{text}`: {why}; write LO:HI, LO: or :HI"))
    };
    let (lo, hi) = text.split_once(':').ok_or_else(|| bad("no colon"))?;
    let side = |s: &str, open: f64| match s.trim() {
        "" => Ok(open),
        s => s.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| bad("not a number")),
    };
    let (lo, hi) = (side(lo, f64::NEG_INFINITY)?, side(hi, f64::INFINITY)?);
    if lo.is_infinite() && hi.is_infinite() {
        return Err(bad("both sides are empty"));
    }
    if lo > hi {
        return Err(bad("the lower end is above the upper one"));
    }
    Ok(IntensitySelection::Range { lo, hi })
}

fn numbers<T: std::str::FromStr>(s: &str, flag: &str, form: &str) -> Result<[T; 3], CliError> {
    let parts: Option<Vec<T>> = s.split(',').map(|p| p.trim().parse().ok()).collect();
    parts
        .and_then(|p| <[T; 3]>::try_from(p).ok())
        .ok_or_else(|| CliError::Usage(format!("{flag} `{s}`: write {form}")))
}

/// `X,Y,Z` in mm.
pub fn point(s: &str, flag: &str) -> Result<DVec3, CliError> {
    let p = DVec3::from(numbers::<f64>(s, flag, "X,Y,Z")?);
    if p.is_finite() { Ok(p) } else { Err(CliError::Usage(format!("{flag} `{s}`: not finite"))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_take_minus_signs_and_open_ends() {
        let range = |lo, hi| IntensitySelection::Range { lo, hi };
        assert_eq!(parse_threshold(":-920").unwrap(), range(f64::NEG_INFINITY, -920.0));
        assert_eq!(parse_threshold("-100:-5.5").unwrap(), range(-100.0, -5.5));
        assert_eq!(parse_threshold("300:").unwrap(), range(300.0, f64::INFINITY));
        for bad in [":", "5", "a:b", "3:2", "nan:1"] {
            assert!(matches!(parse_threshold(bad), Err(CliError::Usage(_))), "{bad}");
        }
    }

    #[test]
    fn labels_follow_the_last_colon_only_when_they_are_numbers() {
        let split = |spec: &str| split_labels(Path::new(spec));
        assert_eq!(split("a.nrrd:1,2"), ("a.nrrd".into(), vec![1, 2]));
        assert_eq!(split("a:b.nrrd"), ("a:b.nrrd".into(), vec![]));
    }
}
