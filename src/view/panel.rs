//! The panel beside the cloth. It changes nothing by itself: it returns what is to be done.

use super::live::{Live, SOLVERS};
use super::playback::Playback;
use super::plots::{Axis, Series, brief, plot};
use super::{Action, Changes, Clock};
use crate::scene::{Fabric, fabrics};
use egui::{Color32, RichText, Slider, Ui};

/// Width of the panel \[points\].
pub(super) const WIDTH: f32 = 310.0;

/// What the panel remembers from picture to picture.
#[derive(Default)]
pub(super) struct Panel {
    /// Iterations while their slider is dragged: each number needs another solver.
    iterations: Option<usize>,
    /// Whether a particle that is let go stays where it is.
    pub pin: bool,
    /// What was done last, or why it failed.
    pub note: String,
}

/// The curves.
#[derive(Default)]
pub struct History {
    /// Energy of each frame \[J\].
    pub energy: Series,
    /// Norm of the gradient at the end of each frame over that at its start.
    pub gradient: Series,
    /// Wall time from picture to picture \[ms\].
    pub picture_ms: Series,
}

impl History {
    pub(super) fn clear(&mut self) {
        [&mut self.energy, &mut self.gradient, &mut self.picture_ms].into_iter().for_each(Series::clear);
    }
}

/// A scene with what the panel needs around it.
pub(super) struct Running<'a> {
    pub live: &'a Live,
    pub clock: &'a Clock,
    pub history: &'a History,
    pub device: &'a str,
}

impl Panel {
    /// Shows the panel of a scene that runs.
    pub fn live(&mut self, ui: &mut Ui, running: &Running<'_>, actions: &mut Vec<Action>) {
        let Running { live, clock, history, device } = *running;
        let broken = live.broken();
        ui.horizontal_wrapped(|ui| {
            let name = if clock.playing { "Pause" } else { "Play" };
            if ui.add_enabled(broken.is_none(), egui::Button::new(name)).clicked() {
                actions.push(Action::Play(!clock.playing));
            }
            if ui.add_enabled(broken.is_none(), egui::Button::new("Step")).clicked() {
                actions.push(Action::Step);
            }
            if ui.button("Reset").clicked() {
                actions.push(Action::Reset);
            }
            if ui.button("View").on_hover_text("Look at the cloth from where it was first seen").clicked() {
                actions.push(Action::Look);
            }
        });
        ui.horizontal_wrapped(|ui| {
            let recording = live.recorder();
            let name =
                recording.map_or("Record".into(), |r| format!("End recording ({} frames)", r.frames()));
            if ui.button(name).clicked() {
                actions.push(Action::Record(recording.is_none()));
            }
            if ui.button("Picture").clicked() {
                actions.push(Action::Picture);
            }
        });
        if let Some(frame) = broken {
            let text =
                format!("Frame {frame} became non-finite. The simulation has ended; reset starts it again.");
            ui.label(RichText::new(text).color(Color32::from_rgb(230, 90, 70)));
        }
        self.note(ui);
        speed(ui, clock, actions);
        ui.separator();
        numbers(ui, running);
        ui.separator();
        plot(ui, ("energy", "J"), &history.energy, Axis::Linear);
        plot(ui, ("gradient, last / first", ""), &history.gradient, Axis::Logarithmic);
        plot(ui, ("time per picture", "ms"), &history.picture_ms, Axis::Linear);
        ui.separator();
        cloth(ui, live, actions);
        ui.separator();
        self.solver(ui, live, actions);
        ui.separator();
        let mut pin = self.pin;
        if ui.checkbox(&mut pin, "pin what is let go").changed() {
            actions.push(Action::Pin(pin));
        }
        if live.has_pinned() && ui.button("Let go of all pinned").clicked() {
            actions.push(Action::Unpin);
        }
        ui.weak("Drag a handle or the cloth; drag beside it, or with the right button, to turn; with Shift or the middle button to move; the wheel zooms. Space pauses, the right arrow steps, R resets.");
        ui.weak(device);
    }

    fn note(&self, ui: &mut Ui) {
        if !self.note.is_empty() {
            ui.label(&self.note);
        }
    }

    fn solver(&mut self, ui: &mut Ui, live: &Live, actions: &mut Vec<Action>) {
        let (name, iterations) = live.solver();
        egui::ComboBox::from_label("solver").selected_text(name).show_ui(ui, |ui| {
            for other in SOLVERS {
                if ui.selectable_label(other == name, other).clicked() && other != name {
                    actions.push(Action::Solve { name: other.to_owned(), iterations: None });
                }
            }
        });
        let mut wanted = self.iterations.unwrap_or(iterations);
        let slider = ui.add(Slider::new(&mut wanted, 1..=200).logarithmic(true).text("iterations"));
        if slider.changed() {
            self.iterations = Some(wanted);
        }
        if !slider.dragged()
            && let Some(wanted) = self.iterations.take()
            && wanted != iterations
        {
            actions.push(Action::Solve { name: name.to_owned(), iterations: Some(wanted) });
        }
    }

    /// Shows the panel of a trajectory that is played back.
    pub fn playback(
        &mut self,
        ui: &mut Ui,
        (playback, clock): (&Playback, &Clock),
        history: &History,
        actions: &mut Vec<Action>,
    ) {
        let frames = playback.trajectory().frames();
        ui.horizontal_wrapped(|ui| {
            if ui.button(if clock.playing { "Pause" } else { "Play" }).clicked() {
                actions.push(Action::Play(!clock.playing));
            }
            if ui.button("Step").clicked() {
                actions.push(Action::Step);
            }
            if ui.button("Reset").clicked() {
                actions.push(Action::Reset);
            }
            if ui.button("View").clicked() {
                actions.push(Action::Look);
            }
            if ui.button("Picture").clicked() {
                actions.push(Action::Picture);
            }
        });
        self.note(ui);
        let mut frame = playback.frame();
        ui.spacing_mut().slider_width = WIDTH - 150.0;
        if ui.add(Slider::new(&mut frame, 0..=frames - 1).text("frame")).changed() {
            actions.push(Action::Seek(frame));
        }
        ui.spacing_mut().slider_width = 130.0;
        speed(ui, clock, actions);
        let mut repeat = playback.repeat;
        if ui.checkbox(&mut repeat, "begin again after the last frame").changed() {
            actions.push(Action::Repeat(repeat));
        }
        let fps = playback.trajectory().fps();
        ui.separator();
        line(ui, "frame", format!("{} of {frames}", playback.frame()));
        line(ui, "time", format!("{:.2} s", playback.frame() as f64 / fps));
        line(ui, "rate", format!("{} frames/s", brief(fps)));
        line(ui, "grid", playback.trajectory().grid().to_string());
        plot(ui, ("time per picture", "ms"), &history.picture_ms, Axis::Linear);
    }
}

fn speed(ui: &mut Ui, clock: &Clock, actions: &mut Vec<Action>) {
    let mut speed = clock.speed;
    if ui.add(Slider::new(&mut speed, 0.05..=4.0).logarithmic(true).text("speed")).changed() {
        actions.push(Action::Speed(speed));
    }
}

fn line(ui: &mut Ui, name: &str, value: String) {
    ui.horizontal(|ui| {
        ui.label(name);
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| ui.monospace(value));
    });
}

/// Shows what the last frame was like.
fn numbers(ui: &mut Ui, running: &Running<'_>) {
    let Running { live, history, .. } = *running;
    let setup = live.setup();
    line(ui, "frame", live.frame().to_string());
    line(ui, "time", format!("{:.2} s", live.frame() as f64 * setup.units.frame_time_s));
    let rate = history.picture_ms.mean(60).map_or("-".into(), |ms| brief(1e3 / f64::from(ms.max(1e-3))));
    line(ui, "pictures/s", rate);
    let Some(stats) = live.stats() else { return };
    line(ui, "largest stretch", format!("{:.1} %", 100.0 * stats.stretch_largest));
    if !stats.bodies.is_empty() {
        let touching: usize = stats.bodies.iter().map(|body| body.touching).sum();
        let deepest = stats.bodies.iter().fold(0.0, |most: f64, body| most.max(body.deepest));
        line(ui, "on bodies", format!("{touching} particles"));
        line(ui, "deepest inside", format!("{:.2} mm", 1e3 * deepest * setup.units.length_m));
    }
    if let Some(layers) = &stats.layers {
        line(ui, "layers touch", format!("{} pairs", layers.touching));
    }
}

/// Shows sliders of what may change.
fn cloth(ui: &mut Ui, live: &Live, actions: &mut Vec<Action>) {
    let (values, mut changes) = (live.values(), live.changes());
    let before = changes;
    let is_own = |fabric: &&Fabric| {
        fabric.moduli == values.moduli && fabric.areal_mass_kg_m2 == values.areal_mass_kg_m2
    };
    let name = fabrics().iter().find(is_own).map_or("another", |fabric| fabric.name);
    egui::ComboBox::from_label("fabric").selected_text(name).show_ui(ui, |ui| {
        for fabric in fabrics() {
            let entry = ui.selectable_label(fabric.name == name, fabric.name);
            if entry.on_hover_text(fabric.description).clicked() {
                changes.moduli = Some(fabric.moduli);
                changes.areal_mass_kg_m2 = Some(fabric.areal_mass_kg_m2);
            }
        }
    });
    let mut moduli = values.moduli;
    let positive = |ui: &mut Ui, value: &mut f64, range, name: &str| {
        let slider = Slider::new(value, range).logarithmic(true).text(name);
        ui.add(slider.custom_formatter(|number, _| brief(number))).changed()
    };
    let stretch = positive(ui, &mut moduli.stretch_modulus, 1.0..=1e5, "stretch N/m");
    let shear = positive(ui, &mut moduli.shear_modulus, 0.1..=1e4, "shear N/m");
    let bend = positive(ui, &mut moduli.bending_stiffness, 1e-7..=0.1, "bend N m");
    if stretch || shear || bend {
        changes.moduli = Some(moduli);
    }
    let mut mass = values.areal_mass_kg_m2;
    if positive(ui, &mut mass, 0.02..=2.0, "mass kg/m²") {
        changes.areal_mass_kg_m2 = Some(mass);
    }
    let mut gravity = values.gravity;
    if ui.add(Slider::new(&mut gravity, 0.0..=20.0).text("gravity m/s²")).changed() {
        changes.gravity = Some(gravity);
    }
    let mut wind = values.wind;
    for (component, name) in wind.iter_mut().zip(["wind x m/s", "wind y", "wind z"]) {
        if ui.add(Slider::new(component, -15.0..=15.0).text(name)).changed() {
            changes.wind = Some([0.0; 3]);
        }
    }
    changes.wind = changes.wind.map(|_| wind);
    if changes != Changes::default() && ui.button("As the scene has it").clicked() {
        changes = Changes::default();
    }
    if changes != before {
        actions.push(Action::Change(changes));
    }
}
