//! What the user does: the pointer beside the panel, and keys.

use super::panel::{self, Running};
use super::{Action, Area, Content, Viewer, camera, pick};
use egui::{Key, PointerButton, Sense};
use glam::{Vec2, Vec3, vec2};

/// What the pointer does beside the panel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Gesture {
    /// It leads a particle; the point is in the plane of its movement.
    Hold(Vec3),
    Turn,
    Pan,
}

impl Viewer {
    /// Shows the panel and follows the pointer and the keys; what is asked for is added to `actions`.
    pub(super) fn ui(&mut self, ui: &mut egui::Ui, actions: &mut Vec<Action>) {
        let side = egui::Panel::right("panel").exact_size(panel::WIDTH).resizable(false);
        side.show(ui, |ui| {
            let beside_the_bar =
                egui::Frame::new().inner_margin(egui::Margin { right: 10, ..Default::default() });
            egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
                beside_the_bar.show(ui, |ui| self.panel(ui, actions));
            });
        });
        egui::CentralPanel::no_frame().show(ui, |ui| {
            let scale = ui.ctx().pixels_per_point();
            let rect = ui.max_rect();
            self.scale = scale;
            self.area = Area {
                corner: [scale * rect.left(), scale * rect.top()],
                size: [scale * rect.width(), scale * rect.height()],
            };
            let response = ui.interact(rect, ui.scope_id().with("cloth"), Sense::drag());
            self.point(ui, &response, actions);
        });
        self.keys(ui, actions);
    }

    fn panel(&mut self, ui: &mut egui::Ui, actions: &mut Vec<Action>) {
        ui.spacing_mut().slider_width = 130.0;
        match &self.content {
            Content::Live(live) => {
                let (clock, history) = (&self.clock, &self.history);
                let running = Running { live, clock, history, device: self.context.name() };
                self.panel.live(ui, &running, actions);
            }
            Content::Playback(playback, _) => {
                self.panel.playback(ui, (playback, &self.clock), &self.history, actions);
            }
        }
    }

    fn keys(&self, ui: &egui::Ui, actions: &mut Vec<Action>) {
        if ui.ctx().egui_wants_keyboard_input() {
            return;
        }
        ui.input(|input| {
            let keys = [
                (Key::Space, Action::Play(!self.clock.playing)),
                (Key::ArrowRight, Action::Step),
                (Key::R, Action::Reset),
            ];
            actions.extend(
                keys.into_iter().filter(|(key, _)| input.key_pressed(*key)).map(|(_, action)| action),
            );
        });
    }

    /// Follows the pointer beside the panel.
    fn point(&mut self, ui: &egui::Ui, response: &egui::Response, actions: &mut Vec<Action>) {
        if response.contains_pointer() {
            let (wheel, pinch) = ui.input(|input| (input.smooth_scroll_delta.y, input.zoom_delta()));
            self.orbit.zoom((wheel / 300.0).exp() * pinch);
        }
        let pointer = response.interact_pointer_pos().map(|at| self.in_area(at));
        if response.drag_started()
            && let Some(pressed) = ui.input(|input| input.pointer.press_origin())
        {
            let pressed = self.in_area(pressed);
            self.gesture = Some(self.begin(ui, response, pressed, actions));
        }
        let by =
            self.scale * vec2(response.drag_delta().x, response.drag_delta().y) / self.area.size[1].max(1.0);
        match (self.gesture, pointer) {
            (Some(Gesture::Turn), _) => self.orbit.turn(by),
            (Some(Gesture::Pan), _) => self.orbit.pan(by),
            (Some(Gesture::Hold(at)), Some(pointer)) => {
                let to = camera::onto_plane(&self.orbit.camera(self.area.size), pointer, at);
                actions.push(Action::Drag(to));
            }
            _ => {}
        }
        if response.drag_stopped() {
            if let Some(Gesture::Hold(_)) = self.gesture {
                actions.push(Action::LetGo);
            }
            self.gesture = None;
        }
    }

    /// Converts a place in points to one in the part that shows the cloth \[px\].
    fn in_area(&self, at: egui::Pos2) -> Vec2 {
        self.scale * vec2(at.x, at.y) - Vec2::from(self.area.corner)
    }

    /// Returns what a press of a button begins.
    fn begin(
        &self,
        ui: &egui::Ui,
        response: &egui::Response,
        pointer: Vec2,
        actions: &mut Vec<Action>,
    ) -> Gesture {
        let shifted = ui.input(|input| input.modifiers.shift);
        if shifted || response.dragged_by(PointerButton::Middle) {
            return Gesture::Pan;
        }
        if !response.dragged_by(PointerButton::Primary) {
            return Gesture::Turn;
        }
        let Content::Live(live) = &self.content else { return Gesture::Turn };
        let positions = live.positions();
        let camera = self.orbit.camera(self.area.size);
        let handles = live.handles();
        match pick::particle(&camera, (pointer, self.scale), &positions, (&self.faces, &handles)) {
            Some(particle) if live.broken().is_none() => {
                actions.push(Action::Take(particle));
                Gesture::Hold(Vec3::from(positions[particle]))
            }
            _ => Gesture::Turn,
        }
    }
}
