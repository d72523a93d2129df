//! Branches that can be taken: their list in the panel, their keys, and clicks on their marks.

use egui::{Key, Pos2, Rect, Ui, pos2};

use super::action::{Action, ActionQueue, Request};
use super::inside_pane::{in_pane, taken_parts};
use super::model::Model;
use super::style::{FAINT, NO_PATH};

/// Keys of the offered branches, in their order. What is offered beyond them is in the list.
pub(super) const BRANCH_KEYS: [Key; 9] = [
    Key::Num1,
    Key::Num2,
    Key::Num3,
    Key::Num4,
    Key::Num5,
    Key::Num6,
    Key::Num7,
    Key::Num8,
    Key::Num9,
];
/// Radius of the mark of a branch in the inside view, points.
pub(super) const MARK_RADIUS: f32 = 11.0;
/// Way that is left to where a branch leaves when it is flown to from the list, mm.
const BEFORE_MM: f64 = 10.0;

/// Lays out the branches that can be taken here, or the way to the next.
pub(super) fn branch_list(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    let offered = model.offered();
    let way = if model.reverse { -1.0 } else { 1.0 };
    ui.horizontal(|ui| {
        ui.strong("Branches");
        let next = model.next_branch().filter(|_| offered.is_empty());
        if let Some(choice) = next {
            let button = ui.button(format!("next at {:.0} mm", choice.arc_mm));
            if button.on_hover_text("Fly to where it leaves").clicked() {
                commands.act(Action::FlyTo(choice.arc_mm - way * BEFORE_MM));
            }
        } else if offered.is_empty() {
            ui.label(egui::RichText::new("none ahead").color(FAINT));
        }
    });
    ui.vertical(|ui| {
        for (i, choice) in offered.iter().enumerate() {
            let ahead = way * (choice.arc_mm - model.arc_mm);
            let place = if ahead < 0.0 { "behind" } else { "ahead" };
            let [length, radius] = [choice.length_mm, choice.radius_mm];
            let text = format!("{}: {:.0} mm {place}, r {radius:.1} mm", i + 1, ahead.abs());
            let tip = format!("Fly along it to its tip, {length:.0} mm from where it leaves");
            if ui.button(text).on_hover_text(tip).clicked() {
                commands.ask(Request::Branch(choice.branch));
            }
        }
    });
}

/// Lays out the way to a place that was clicked, and how the crosshair becomes such a place.
pub(super) fn way_to_target(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    ui.strong("Way to a place");
    let can = model.path.is_some();
    let button = ui.add_enabled(can, egui::Button::new("To the crosshair"));
    let tip = "Flies through the tree to the place nearest to the crosshair of the slices";
    if button.on_hover_text(tip).on_disabled_hover_text(NO_PATH).clicked() {
        commands.ask(Request::FlyThrough(model.crosshair_mm.to_array()));
    }
    let Some(way) = &model.way else {
        let hint = "Or click in a slice or in the overview.";
        ui.label(egui::RichText::new(hint).color(FAINT));
        return;
    };
    ui.label(format!("{:.0} mm, then {:.0} mm beside the path", way.arc_mm, way.beside_mm));
    let (diameter, at) = way.narrowest;
    let narrowest = format!("Narrowest: {diameter:.1} mm across, at {at:.0} mm");
    ui.label(narrowest)
        .on_hover_text("Twice the least distance of the path to the wall on the way");
    for (i, (arc, side)) in way.turns.iter().enumerate() {
        let text = format!("{}. at {arc:.0} mm towards {side}", i + 1);
        if ui.selectable_label(false, text).on_hover_text("Fly to the turn").clicked() {
            commands.act(Action::FlyTo(arc - BEFORE_MM));
        }
    }
}

/// Takes the keys of the branches; whether one was used.
pub(super) fn branch_keys(ui: &Ui, model: &Model, commands: &mut ActionQueue) -> bool {
    let mut is_used = false;
    for (key, choice) in BRANCH_KEYS.into_iter().zip(model.offered()) {
        if ui.input(|i| i.key_pressed(key)) {
            commands.ask(Request::Branch(choice.branch));
            is_used = true;
        }
    }
    is_used
}

/// The branch whose mark in the inside view lies under a point.
pub(super) fn branch_under(rect: Rect, p: Pos2, model: &Model) -> Option<usize> {
    let marks = branch_marks(rect, &taken_parts(rect, model), model);
    marks.into_iter().find(|mark| mark.at.distance(p) <= MARK_RADIUS).map(|mark| mark.branch)
}

/// Mark of a branch in the inside view.
pub(super) struct BranchMark {
    pub branch: usize,
    /// Number of its key.
    pub number: usize,
    /// Place in the picture where the branch begins.
    pub place: Pos2,
    /// Middle of the mark.
    pub at: Pos2,
}

/// Returns the marks of the branches that begin in the picture: where they begin, or beside what
/// lies over the picture there.
pub(super) fn branch_marks(rect: Rect, taken: &[Rect], model: &Model) -> Vec<BranchMark> {
    let inside = rect.shrink(MARK_RADIUS);
    let mark = |(i, branch, place): (usize, usize, Pos2)| {
        let at = taken.iter().fold(inside.clamp(place), |at, part| {
            let part = part.expand(MARK_RADIUS + 1.0);
            if !part.contains(at) {
                return at;
            }
            let beside = [
                pos2(part.left(), at.y),
                pos2(part.right(), at.y),
                pos2(at.x, part.top()),
                pos2(at.x, part.bottom()),
            ];
            let free = beside.into_iter().filter(|p| inside.contains(*p));
            free.min_by(|a, b| a.distance(at).total_cmp(&b.distance(at))).unwrap_or(at)
        });
        BranchMark { branch, number: i + 1, place, at }
    };
    let seen = model.offered().into_iter().enumerate().filter_map(|(i, c)| {
        let place = in_pane(rect, c.ahead_mm, model).filter(|at| rect.contains(*at))?;
        Some((i, c.branch, place))
    });
    seen.map(mark).collect()
}

#[cfg(test)]
mod tests {
    use super::super::junctions::BranchChoice;
    use super::super::junctions::tests::{path, tree};
    use super::super::panel_tests::TestScreen;
    use super::*;
    use crate::volume::phantom::Kind;

    /// A model at a place where so many branches leave.
    fn model_with(branches: usize) -> Model {
        let mut model = Model::new(20.0);
        model.path = Some(path(&tree(), 0));
        let choice = |i: usize| BranchChoice {
            branch: 100 + i,
            arc_mm: 1.0 + 0.1 * i as f64,
            ahead_mm: glam::DVec3::ZERO,
            length_mm: 30.0,
            radius_mm: 2.0,
        };
        model.choices = (0..branches).map(choice).collect();
        model
    }

    #[test]
    fn a_branch_mark_lies_beside_a_legend_and_is_clicked_there() {
        let (model, _session) = super::super::model::flown_model(Kind::Y, |s| {
            s.centerline.tree = true;
        });
        let rect = Rect::from_min_size(pos2(0.0, 0.0), egui::vec2(500.0, 400.0));
        let mut model = model;
        let choice = model.choices.first().expect("a branch").arc_mm;
        model.step(0.0, &[Action::Seek(choice - 8.0)]);
        let free = branch_marks(rect, &[], &model);
        let [mark, ..] = &free[..] else { panic!("no branch is in view") };
        assert_eq!((mark.number, mark.place), (1, mark.at));
        // A legend over it: the mark is beside, and names the same place.
        let legend = Rect::from_center_size(mark.at, egui::vec2(60.0, 30.0));
        let moved = &branch_marks(rect, &[legend], &model)[0];
        assert_eq!(moved.place, mark.place);
        let ground = Rect::from_center_size(moved.at, egui::Vec2::splat(2.0 * MARK_RADIUS));
        assert!(!ground.intersects(legend) && rect.contains_rect(ground), "{ground:?}");
        assert_eq!(branch_under(rect, mark.at, &model), Some(mark.branch));
    }

    #[test]
    fn every_branch_that_is_offered_can_be_taken_also_beyond_the_keys() {
        let model = model_with(11);
        let mut screen = TestScreen::new();
        for i in [0, 2, 10] {
            let mut commands = ActionQueue::default();
            let text = format!("{}: {:.0} mm ahead, r 2.0 mm", i + 1, model.choices[i].arc_mm);
            if i == 10 {
                // The last is below the list's edge until it is scrolled to.
                let down = egui::vec2(0.0, -9000.0);
                let wheel = egui::Event::MouseWheel {
                    unit: egui::MouseWheelUnit::Point,
                    delta: down,
                    phase: egui::TouchPhase::Move,
                    modifiers: egui::Modifiers::NONE,
                };
                let over = egui::Event::PointerMoved(egui::pos2(60.0, 60.0));
                screen.frame(vec![over, wheel], |ui| branch_list(ui, &model, &mut commands));
                for _ in 0..60 {
                    screen.frame(Vec::new(), |ui| branch_list(ui, &model, &mut commands));
                }
            }
            screen.click(&text, |ui| branch_list(ui, &model, &mut commands));
            assert_eq!(commands.requests, [Request::Branch(100 + i)]);
        }
    }

    #[test]
    fn nine_digits_take_branches_and_five_is_the_way_back_where_fewer_are_offered() {
        let pressed = |key, model: &Model| {
            let mut commands = ActionQueue::default();
            let event = egui::Event::Key {
                key,
                physical_key: None,
                pressed: true,
                repeat: false,
                modifiers: egui::Modifiers::NONE,
            };
            let keys = |ui: &mut Ui| super::super::keys::keys(ui, model, false, &mut commands);
            TestScreen::new().frame(vec![event], keys);
            commands
        };
        let many = model_with(9);
        assert_eq!(pressed(Key::Num5, &many).requests, [Request::Branch(104)]);
        assert_eq!(pressed(Key::Num9, &many).requests, [Request::Branch(108)]);
        assert_eq!(pressed(Key::Num0, &many).actions, [Action::BackToPath]);
        let few = pressed(Key::Num5, &model_with(4));
        assert_eq!((few.actions, few.requests), (vec![Action::BackToPath], Vec::new()));
    }

    #[test]
    fn where_no_branch_leaves_the_list_leads_to_the_next() {
        let mut model = model_with(1);
        model.choices[0].arc_mm = 45.0;
        let (mut screen, mut commands) = (TestScreen::new(), ActionQueue::default());
        screen.click("next at 45 mm", |ui| branch_list(ui, &model, &mut commands));
        assert_eq!(commands.actions, [Action::FlyTo(35.0)]);
        model.reverse = true;
        assert_eq!(model.next_branch(), None);
    }
}
