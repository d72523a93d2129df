//! Organs of torsos made by formula, of any contrast, marrow, thickness, noise, crop and position: what
//! is found is that organ, and what is there is found.

use common::torso::{AortaDisease, Torso, Tube};
use glam::DVec3;
use intima::organ::{Organ, OrganError, OrganOptions};
use intima::volume::Grid;

/// Outcome of a question for an organ.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Outcome {
    /// Found, and most of it is that organ.
    Right,
    /// Not found, and not there or only a part of it.
    Refused,
    /// Not found, though there.
    Missed,
    /// Found, and a quarter or more of it is something else.
    Wrong,
}

/// An answer with its confidence, and the words of a refusal.
struct Answer {
    outcome: Outcome,
    confidence: f64,
    words: String,
}

fn ask(torso: &Torso, organ: Organ, scan: &intima::volume::Volume) -> Answer {
    let (tubes, is_there): (&[Tube], bool) = match organ {
        Organ::Airway => (&torso.airway, torso.shows_airway()),
        Organ::Colon => (&torso.colon, torso.shows_colon()),
        Organ::Vessel => (&torso.aorta, torso.shows_aorta()),
    };
    match OrganOptions::from(organ).find(scan) {
        Ok(found) => {
            let beyond_mm = 3.0 + 0.5 * scan.grid.spacing_mm.max_element();
            let share = torso.share_near(&found.mask, tubes, beyond_mm);
            let outcome = if share >= 0.75 { Outcome::Right } else { Outcome::Wrong };
            let words = format!("share {share:.2}; {}", found.reasons.join("; "));
            Answer { outcome, confidence: found.confidence, words }
        }
        Err(OrganError::NotFound { why, .. }) => {
            let outcome = if is_there { Outcome::Missed } else { Outcome::Refused };
            Answer { outcome, confidence: 0.0, words: why }
        }
        Err(other) => panic!("{other}"),
    }
}

#[test]
fn an_aorta_with_a_flap_a_stent_or_clot_is_found() {
    let diseases = [
        (AortaDisease::Dissection { false_hu: 330.0 }, true),
        (AortaDisease::Dissection { false_hu: 200.0 }, false),
        (AortaDisease::Stent { wire_hu: 3000.0 }, true),
        (AortaDisease::Clot { radius_mm: 35.0 }, false),
    ];
    for (disease, is_parted) in diseases {
        let mut torso = Torso { disease: Some(disease), ..Torso::default() };
        torso.grid = Grid::axis_aligned([240, 160, 165], [1.5, 1.5, 2.0]);
        torso.grid.origin_mm = DVec3::new(-180.0, -120.0, -155.0);
        let answer = ask(&torso, Organ::Vessel, &torso.scan());
        assert_eq!(answer.outcome, Outcome::Right, "{disease:?}: {}", answer.words);
        assert_eq!(answer.words.contains("a flap"), is_parted, "{disease:?}: {}", answer.words);
        assert!(!is_parted || answer.confidence <= 0.4, "{disease:?}: {}", answer.confidence);
    }
}

#[test]
fn organs_of_six_torsos_are_right_or_refused() {
    organs_are_right_or_refused(0..6);
}

#[test]
#[ignore = "minutes: cargo test --release --test geometry five_hundred -- --ignored --nocapture"]
fn organs_of_five_hundred_torsos_are_right_or_refused() {
    organs_are_right_or_refused(0..500);
}

fn organs_are_right_or_refused(seeds: std::ops::Range<u64>) {
    let mut all: Vec<(Organ, Answer)> = Vec::new();
    for seed in seeds {
        let torso = Torso::random(seed);
        let scan = torso.scan();
        for organ in Organ::ALL {
            let answer = ask(&torso, organ, &scan);
            let [dims, h] = [scan.grid.dims.as_dvec3(), scan.grid.spacing_mm];
            println!(
                "{seed} {} {:?} {:.2} | {dims} {:.1} {:.1} mm, blood {:.0} vein {:.0} marrow {:.0}, \
                 noise {:.0}, prone {}, stomach {} | {}",
                organ.name(),
                answer.outcome,
                answer.confidence,
                h.x,
                h.z,
                torso.blood_hu * f64::from(u8::from(!torso.aorta.is_empty())),
                torso.vein_hu,
                torso.marrow_hu,
                torso.noise_hu,
                torso.is_prone,
                torso.has_stomach,
                &answer.words.chars().take(600).collect::<String>()
            );
            all.push((organ, answer));
        }
    }
    let number = |of: &dyn Fn(&(Organ, Answer)) -> bool| all.iter().filter(|a| of(a)).count();
    for organ in Organ::ALL {
        let of = |outcome| number(&|a| a.0 == organ && a.1.outcome == outcome);
        let [right, refused, missed, wrong] =
            [Outcome::Right, Outcome::Refused, Outcome::Missed, Outcome::Wrong].map(of);
        println!(
            "{}: right {right}, refused {refused}, missed {missed}, wrong {wrong}",
            organ.name()
        );
    }
    for least in [0.9, 0.5] {
        let sure = number(&|a| a.1.confidence >= least);
        let right = number(&|a| a.1.confidence >= least && a.1.outcome == Outcome::Right);
        println!("of {sure} answers at {least} or more {right} are right");
    }
    let wrong = number(&|a| a.1.outcome == Outcome::Wrong);
    let fit = number(&|a| matches!(a.1.outcome, Outcome::Right | Outcome::Refused));
    println!("{wrong} wrong, {fit} of {} found or rightly refused", all.len());
    assert!(100 * wrong <= all.len(), "{wrong} of {} are wrong", all.len());
    assert!(10 * fit >= 9 * all.len(), "{fit} of {}", all.len());
}
