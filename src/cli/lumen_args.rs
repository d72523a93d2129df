//! Choosing the lumen: INPUT, `--mask`, `--threshold`, seeds.

use std::path::{Path, PathBuf};

use glam::{DVec3, IVec3, UVec3};

use super::CliError;
use super::global::Global;
use super::input::{read_checked, resampled};
use crate::lumen::{Found, Lumen, LumenError, Recipe, Window};
use crate::volume::{Rescale, SampleType, Volume};

/// LUMEN flags.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Choosing the lumen")]
pub struct LumenArgs {
    /// Label map: FILE, FILE:LABEL or FILE:LABEL,LABEL…
    #[arg(long, value_name = "FILE[:LABEL…]", conflicts_with = "threshold")]
    pub mask: Option<String>,
    /// Inclusive range in HU or stored units after rescale; either side may be empty
    #[arg(long, value_name = "LO:HI", allow_hyphen_values = true)]
    pub threshold: Option<String>,
    /// Keep the component of this voxel (x fastest)
    #[arg(long, value_name = "I,J,K", conflicts_with = "seed_mm")]
    pub seed: Option<String>,
    /// Keep the component of the voxel at this point, LPS mm
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub seed_mm: Option<String>,
    /// Keep every component
    #[arg(long)]
    pub all_components: bool,
    /// Leave closed cavities open
    #[arg(long)]
    pub no_fill: bool,
    /// Draw the threshold in to just below the first leak (needs a seed)
    #[arg(long)]
    pub leak_control: bool,
    /// DICOM series: UID, or index from 0
    #[arg(long, value_name = "UID|INDEX")]
    pub series: Option<String>,
}

/// A volume and the recipe for its lumen.
pub struct Chosen {
    /// What was read.
    pub volume: Volume,
    /// How to choose.
    pub recipe: Recipe,
}

/// Most distinct values of a volume that is taken for a label map without being told.
const LABELS: usize = 32;

impl LumenArgs {
    /// Reads the input and makes the recipe.
    pub fn load(&self, input: Option<&Path>, global: &Global) -> Result<Chosen, CliError> {
        let (volume, window) = self.volume_and_window(input, global)?;
        let seed = self.seed_voxel(&volume)?;
        if self.leak_control && seed.is_none() {
            return Err(CliError::Usage("--leak-control needs --seed or --seed-mm".into()));
        }
        let recipe = Recipe {
            window,
            seed,
            all_components: self.all_components,
            fill: !self.no_fill,
            leak_control: self.leak_control,
        };
        Ok(Chosen { volume, recipe })
    }

    fn volume_and_window(
        &self,
        input: Option<&Path>,
        global: &Global,
    ) -> Result<(Volume, Window), CliError> {
        let read = |path: &Path| read_checked(path, self.series.as_deref(), global);
        if let Some(spec) = &self.mask {
            let (path, labels) = split_labels(spec)?;
            let mask = read(&path)?;
            let window = Window::Labels(labels);
            let volume = match input {
                None => mask,
                Some(input) => {
                    let volume = read(input)?;
                    if same_grid(&volume, &mask) {
                        mask
                    } else {
                        global.warn("the mask lies on another grid: resampled to the input's, nearest label");
                        resampled(&mask, volume.grid)
                    }
                }
            };
            return Ok((volume, window));
        }
        let input = input.ok_or_else(|| CliError::Usage("an INPUT or --mask is needed".into()))?;
        let volume = read(input)?;
        if let Some(t) = &self.threshold {
            return Ok((volume, parse_threshold(t)?));
        }
        if is_label_map(&volume) {
            return Ok((volume, Window::Labels(Vec::new())));
        }
        Err(CliError::Usage(format!(
            "{}: not a label map, so the lumen must be chosen: --mask FILE[:LABEL], \
             --threshold LO:HI with --seed I,J,K, or --threshold LO:HI alone for the largest component",
            input.display()
        )))
    }

    fn seed_voxel(&self, volume: &Volume) -> Result<Option<UVec3>, CliError> {
        if let Some(s) = &self.seed {
            let [i, j, k] = numbers::<i64>(s, "--seed", "I,J,K")?;
            let v = [i, j, k].map(|n| u32::try_from(n).unwrap_or(u32::MAX));
            return Ok(Some(UVec3::from(v)));
        }
        if let Some(s) = &self.seed_mm {
            let p = point(s, "--seed-mm")?;
            let v = volume.grid.nearest_voxel(p);
            return v.map(Some).ok_or_else(|| LumenError::SeedPoint(p.to_array()).into());
        }
        Ok(None)
    }
}

impl Chosen {
    /// Chooses the lumen and says what is worth knowing.
    pub fn lumen(&self, global: &Global) -> Result<(Lumen, Found), CliError> {
        lumen(&self.volume, &self.recipe, global)
    }
}

/// Chooses the lumen of a volume and says what is worth knowing.
pub fn lumen(
    volume: &Volume,
    recipe: &Recipe,
    global: &Global,
) -> Result<(Lumen, Found), CliError> {
    let (lumen, found) = recipe.apply(volume)?;
    if lumen.bricks.is_empty() {
        let (window, range) = (recipe.window.clone(), volume.range());
        return Err(LumenError::Empty { window, range }.into());
    }
    for line in notes(recipe, &lumen, &found) {
        global.warn(line);
    }
    let bytes = crate::pipeline::estimate_bytes(
        volume.samples.bytes().len() as u64,
        volume.grid.len() as u64,
        lumen.bricks.len() as u64,
    );
    tracing::info!("about {} MB will be needed", bytes / 1_000_000);
    crate::pipeline::refuse_above(global.max_memory, bytes, "volume, fields and surface")?;
    Ok((lumen, found))
}

/// A voxel to track the surface from: the seed, where one was given.
pub fn track_from(recipe: &Recipe) -> Option<IVec3> {
    recipe.seed.filter(|_| !recipe.all_components).map(|s| s.as_ivec3())
}

/// What a user should know about how the lumen came out.
pub fn notes(recipe: &Recipe, lumen: &Lumen, found: &Found) -> Vec<String> {
    let mut out = Vec::new();
    if let Some(leak) = found.leak {
        let leaks = leak.leak_ml.map_or("no leak found".to_owned(), |ml| {
            format!("the next step would fill {ml:.0} ml")
        });
        let (t, v) = (leak.threshold, leak.volume_ml);
        out.push(format!("leak control: threshold {t} holds {v:.1} ml; {leaks}"));
    }
    if recipe.seed.is_none() && !recipe.all_components && !found.others.is_empty() {
        let listed: Vec<String> =
            found.others.iter().take(3).map(|c| format!("{} at {}", c.voxels, c.first)).collect();
        out.push(format!(
            "kept the largest of {} components; left out {} voxels ({}{})",
            found.others.len() + 1,
            found.other_voxels,
            listed.join(", "),
            if found.others.len() > 3 { ", …" } else { "" }
        ));
    }
    if lumen.touches_edge {
        out.push("the lumen touches the edge of the volume; it is closed there by caps".into());
    }
    out
}

fn same_grid(a: &Volume, b: &Volume) -> bool {
    let (g, h) = (&a.grid, &b.grid);
    let corner = g.dims.as_dvec3();
    let off = |p: DVec3| {
        (g.world_from_voxel().transform_point3(p) - h.world_from_voxel().transform_point3(p))
            .length()
    };
    g.dims == h.dims && off(DVec3::ZERO).max(off(corner)) < 0.01 * g.spacing_mm.min_element()
}

fn is_label_map(volume: &Volume) -> bool {
    if !volume.samples.sample_type().is_integer() || volume.rescale != Rescale::IDENTITY {
        return false;
    }
    let mut seen: Vec<i64> = Vec::new();
    let bytes = volume.samples.sample_type() == SampleType::U8;
    for i in 0..volume.samples.len() {
        let v = volume.samples.get(i) as i64;
        if !seen.contains(&v) {
            // Labels are small and not negative; the many values of an image show at once.
            if v < 0 || (!bytes && v > 10_000) || seen.len() == LABELS {
                return false;
            }
            seen.push(v);
        }
    }
    true
}

/// `FILE:1,2` into path and labels; a path that exists as it stands has no labels.
fn split_labels(spec: &str) -> Result<(PathBuf, Vec<i64>), CliError> {
    if Path::new(spec).exists() {
        return Ok((spec.into(), Vec::new()));
    }
    let labels = spec.rsplit_once(':').and_then(|(path, labels)| {
        let labels: Option<Vec<i64>> = labels.split(',').map(|l| l.trim().parse().ok()).collect();
        Some((PathBuf::from(path), labels?))
    });
    Ok(labels.unwrap_or_else(|| (spec.into(), Vec::new())))
}

/// `LO:HI`, either side empty.
pub fn parse_threshold(text: &str) -> Result<Window, CliError> {
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
    Ok(Window::Range { lo, hi })
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
        let range = |lo, hi| Window::Range { lo, hi };
        assert_eq!(parse_threshold(":-920").unwrap(), range(f64::NEG_INFINITY, -920.0));
        assert_eq!(parse_threshold("-100:-5.5").unwrap(), range(-100.0, -5.5));
        assert_eq!(parse_threshold("300:").unwrap(), range(300.0, f64::INFINITY));
        for bad in [":", "5", "a:b", "3:2", "nan:1"] {
            assert!(matches!(parse_threshold(bad), Err(CliError::Usage(_))), "{bad}");
        }
    }

    #[test]
    fn labels_follow_the_last_colon_only_when_they_are_numbers() {
        let split = |s| split_labels(s).unwrap();
        assert_eq!(split("a.nrrd:1,2"), ("a.nrrd".into(), vec![1, 2]));
        assert_eq!(split("a:b.nrrd"), ("a:b.nrrd".into(), vec![]));
    }
}
