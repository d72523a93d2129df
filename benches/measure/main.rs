//! Measurements on large meshes, by name: `INTIMA_MESHES=FOLDER cargo bench --bench measure -- NAME`.
//! The folder holds meshes as PLY with their axes as JSON (`tests/common/src/fly.rs`); what is not
//! there is left out. Figures go to `benches/results`.

mod figures;
mod lod;
mod near;
mod simplify;

const ALL: [(&str, fn()); 9] = [
    ("cut", lod::times_of_the_cut),
    ("figures", figures::trachea_and_colon_as_in_the_papers_figures),
    ("frame-times", lod::frame_times_of_each_form),
    ("growth", lod::growth_of_the_frame_time),
    ("phantoms", near::silhouettes_of_phantoms),
    ("rings", near::silhouettes_of_rings),
    ("near", near::silhouettes_beside_ray_casting),
    ("pixels", lod::pixels_inside_the_bound),
    ("simplify", simplify::times_and_deviations),
];

fn main() {
    let names: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let chosen = ALL.iter().filter(|(name, _)| names.iter().any(|n| n == name));
    if chosen.clone().map(|(_, measure)| measure()).count() == 0 {
        println!("INTIMA_MESHES=FOLDER cargo bench --bench measure -- NAME, of");
        ALL.iter().for_each(|(name, _)| println!("  {name}"));
    }
}
