//! A window in which a scene runs or a recorded trajectory is played back.
//!
//! [`Viewer`] takes input events and draws into any picture; [`run`] gives it a window, [`Offscreen`] a picture without one. The
//! simulation and the drawing share one device: [`crate::sim::Vertices`] are drawn where they are.

mod camera;
mod changes;
mod clock;
mod draw;
mod grip;
mod input;
mod live;
mod offscreen;
mod panel;
mod pick;
mod playback;
mod plots;
mod record;
mod shell;
mod solids;

pub use camera::Orbit;
pub use changes::{Changes, Values};
pub use clock::Clock;
pub use draw::Area;
pub use egui;
pub use live::{Live, SOLVERS};
pub use offscreen::{FORMAT, Offscreen};
pub use panel::History;
pub use playback::Playback;
pub use plots::Series;
pub use record::Recorder;
pub use shell::run;

use crate::gpu::Context;
use crate::io::{create_folder, vertex_normals};
use crate::render::shared::{FONT, Lights};
use crate::render::{Image, write_png};
use crate::{Error, Result};
use draw::{Painter, Shown};
use egui_wgpu::ScreenDescriptor;
use glam::{Vec2, Vec3};
use input::Gesture;
use panel::Panel;
use record::free_name;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What a viewer shows.
pub enum Content {
    /// A scene that runs.
    Live(Box<Live>),
    /// A trajectory, and the upward direction of its axes.
    Playback(Box<Playback>, [f32; 3]),
}

/// What the panel or the pointer asks for ([`Viewer::act`]).
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Lets time run, or pauses.
    Play(bool),
    /// Goes one frame on, and pauses.
    Step,
    /// Lets time run so many times faster than life.
    Speed(f64),
    /// Goes back to the start, and ends a recording.
    Reset,
    /// Replaces values of the scene.
    Change(Changes),
    /// Goes on with another solver; without iterations, with those that suit it.
    Solve {
        /// One of [`SOLVERS`].
        name: String,
        /// Iterations per frame.
        iterations: Option<usize>,
    },
    /// Takes hold of a particle.
    Take(usize),
    /// Leads the particle that is held to a place \[m\].
    Drag(Vec3),
    /// Lets go of the particle that is held.
    LetGo,
    /// Whether particles stay where they are let go from now on.
    Pin(bool),
    /// Lets go of the particles that were pinned.
    Unpin,
    /// Shows a frame of a trajectory.
    Seek(usize),
    /// Whether a trajectory begins again after its last frame.
    Repeat(bool),
    /// Begins a recording, or ends it.
    Record(bool),
    /// Writes a picture of what is shown.
    Picture,
    /// Looks from where the cloth was first seen.
    Look,
}

/// The state of the window: what it shows, from where, and the panel.
pub struct Viewer {
    context: Context,
    content: Content,
    painter: Painter,
    renderer: egui_wgpu::Renderer,
    egui: egui::Context,
    format: wgpu::TextureFormat,
    orbit: Orbit,
    home: Orbit,
    /// Where the cloth faces at the start, along the camera's axes.
    facing: Vec3,
    faces: Vec<[u32; 3]>,
    clock: Clock,
    panel: Panel,
    history: History,
    gesture: Option<Gesture>,
    area: Area,
    /// Pixels per point, and the size of the last picture \[px\].
    scale: f32,
    size: [u32; 2],
    /// The panel as triangles.
    jobs: Vec<egui::ClippedPrimitive>,
    /// Whether the panel is to be drawn again soon although nothing moves.
    restless: bool,
    /// Folder of recordings and pictures.
    out: PathBuf,
    files: Vec<PathBuf>,
}

impl Viewer {
    /// Shows `content` in pictures of a format and about a size; recordings and pictures are written into the folder `out`.
    /// Fails if the device cannot draw them.
    pub fn new(
        context: &Context,
        content: Content,
        (format, size): (wgpu::TextureFormat, [u32; 2]),
        out: &Path,
    ) -> Result<Self> {
        context.checked(|| Ok(Self::build(context, content, (format, size), out)))
    }

    fn build(
        context: &Context,
        content: Content,
        (format, size): (wgpu::TextureFormat, [u32; 2]),
        out: &Path,
    ) -> Self {
        let egui = egui::Context::default();
        let families = [egui::FontFamily::Proportional, egui::FontFamily::Monospace];
        let priority = egui::epaint::text::FontPriority::Highest;
        let families = families.map(|family| egui::epaint::text::InsertFontFamily { family, priority });
        let data = egui::FontData::from_static(FONT);
        egui.add_font(egui::epaint::text::FontInsert::new("DejaVu Sans", data, families.into()));
        egui.set_theme(egui::Theme::Dark);
        let (positions, faces, up) = match &content {
            Content::Live(live) => {
                let model = &live.setup().model;
                (live.positions(), model.cloths[0].faces(model.grid), live.up())
            }
            Content::Playback(playback, up) => {
                (playback.positions().to_vec(), playback.trajectory().faces(), Vec3::from(*up))
            }
        };
        let normals = vertex_normals(&positions, &faces);
        let shown = [size[0] as f32 - panel::WIDTH, size[1] as f32].map(|side| side.max(1.0));
        let orbit = Orbit::around(&seen(&content, &positions), &normals, up, shown);
        let facing = orbit.rotation() * normals.iter().map(|&n| Vec3::from(n)).sum::<Vec3>();
        let options = egui_wgpu::RendererOptions::default();
        Self {
            painter: Painter::new(&context.device, &context.queue, format),
            renderer: egui_wgpu::Renderer::new(&context.device, format, options),
            context: context.clone(),
            content,
            egui,
            format,
            orbit,
            home: orbit,
            facing,
            faces,
            clock: Clock::default(),
            panel: Panel::default(),
            history: History::default(),
            gesture: None,
            area: Area::default(),
            scale: 1.0,
            size,
            jobs: Vec::new(),
            restless: true,
            out: out.to_owned(),
            files: Vec::new(),
        }
    }

    /// Returns the scene that runs, if it is one.
    pub fn live(&self) -> Option<&Live> {
        match &self.content {
            Content::Live(live) => Some(live),
            Content::Playback(..) => None,
        }
    }

    /// Returns the trajectory that is played back, if it is one.
    pub fn playback(&self) -> Option<&Playback> {
        match &self.content {
            Content::Live(_) => None,
            Content::Playback(playback, _) => Some(playback),
        }
    }

    /// Returns the camera, which may be moved.
    pub fn orbit(&mut self) -> &mut Orbit {
        &mut self.orbit
    }

    /// Returns the part of the picture that shows the cloth \[px\].
    pub fn area(&self) -> Area {
        self.area
    }

    /// Returns the place of a point \[m\] in the picture \[px\]; `None` if it is not in front of the eye.
    pub fn place_of(&self, at: [f32; 3]) -> Option<[f32; 2]> {
        let place = camera::place_of(&self.orbit.camera(self.area.size), Vec3::from(at))?;
        Some((place + Vec2::from(self.area.corner)).to_array())
    }

    /// Returns the clock.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Returns the curves.
    pub fn history(&self) -> &History {
        &self.history
    }

    /// Returns what was done last, or why it failed.
    pub fn note(&self) -> &str {
        &self.panel.note
    }

    /// Returns the files that were written, in their order.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// Whether the next picture differs from this one without any event.
    pub fn is_moving(&self) -> bool {
        self.clock.playing || self.restless
    }

    pub(super) fn egui(&self) -> &egui::Context {
        &self.egui
    }

    /// Takes the input since the last picture, `elapsed` ago, goes on with the frames that are due, and draws into a picture of
    /// so many pixels, of the format that the viewer was made for. Fails if the device is lost; whatever else fails is told in
    /// the panel.
    pub fn frame(
        &mut self,
        input: egui::RawInput,
        (target, size): (&wgpu::TextureView, [u32; 2]),
        elapsed: Duration,
    ) -> Result<egui::PlatformOutput> {
        if !elapsed.is_zero() {
            self.history.picture_ms.push(1e3 * elapsed.as_secs_f32());
        }
        let (egui, mut actions) = (self.egui.clone(), Vec::new());
        let output = egui.run_ui(input, |ui| {
            actions.clear();
            self.ui(ui, &mut actions);
        });
        let egui::FullOutput {
            platform_output,
            mut textures_delta,
            shapes,
            pixels_per_point,
            viewport_output,
        } = output;
        let delays = viewport_output.values().map(|viewport| viewport.repaint_delay);
        self.restless = delays.min().is_some_and(|delay| delay < Duration::from_millis(100));
        for (id, deltas) in &textures_delta.set {
            for delta in deltas {
                self.renderer.update_texture(&self.context.device, &self.context.queue, *id, delta);
            }
        }
        self.jobs = egui.tessellate(shapes, pixels_per_point);
        (self.scale, self.size) = (pixels_per_point, size);
        let picture = actions.contains(&Action::Picture);
        actions.retain(|action| *action != Action::Picture);
        let mut done = actions.into_iter().try_for_each(|action| self.act(action));
        done = done.and_then(|()| self.advance(elapsed));
        done = done.and_then(|()| {
            self.paint(target, size);
            if picture { self.act(Action::Picture) } else { Ok(()) }
        });
        textures_delta.free.iter().for_each(|id| self.renderer.free_texture(id));
        textures_delta.clear();
        match done {
            Err(error @ Error::Lost(_)) => Err(error),
            Err(error) => {
                self.panel.note = error.to_string();
                self.clock.playing = false;
                self.paint(target, size);
                Ok(platform_output)
            }
            Ok(()) => Ok(platform_output),
        }
    }

    /// Does what is asked for. What does not apply, such as a frame of a trajectory for a scene, is left.
    pub fn act(&mut self, action: Action) -> Result<()> {
        self.restless = true;
        match action {
            Action::Play(playing) => {
                self.clock.playing = playing;
                return self.settle();
            }
            Action::Speed(speed) => self.clock.speed = speed,
            Action::Step => {
                self.clock.playing = false;
                return self.skip(1);
            }
            Action::Look => self.orbit = self.home,
            Action::Pin(pin) => self.panel.pin = pin,
            Action::Picture => return self.write_picture(),
            Action::Record(true) => return self.record(),
            Action::Record(false) => return self.end_recording(),
            Action::Reset => {
                self.end_recording()?;
                self.history.clear();
                if let Content::Playback(playback, _) = &mut self.content {
                    playback.seek(0);
                }
            }
            Action::Seek(frame) => {
                if let Content::Playback(playback, _) = &mut self.content {
                    self.clock.playing = false;
                    playback.seek(frame);
                }
            }
            Action::Repeat(repeat) => {
                if let Content::Playback(playback, _) = &mut self.content {
                    playback.repeat = repeat;
                }
            }
            _ => {}
        }
        let Content::Live(live) = &mut self.content else { return Ok(()) };
        match action {
            Action::Reset => live.reset(),
            Action::Change(changes) => live.change(changes),
            Action::Solve { name, iterations } => live.solve_with(&name, iterations),
            Action::Take(particle) => live.take(particle),
            Action::Drag(to) => {
                live.drag(to);
                Ok(())
            }
            Action::LetGo => live.let_go(self.panel.pin),
            Action::Unpin => live.unpin(),
            _ => Ok(()),
        }
    }

    /// Goes so many frames on, and waits for them.
    pub fn skip(&mut self, frames: usize) -> Result<()> {
        match &mut self.content {
            Content::Live(live) => (0..frames).try_for_each(|_| live.step())?,
            Content::Playback(playback, _) => drop(playback.advance(frames)),
        }
        self.settle()
    }

    /// Waits for the frames that were begun.
    pub fn settle(&mut self) -> Result<()> {
        if let Content::Live(live) = &mut self.content {
            live.settle()?;
        }
        self.note_frames();
        Ok(())
    }

    fn advance(&mut self, elapsed: Duration) -> Result<()> {
        let seconds = elapsed.as_secs_f64();
        match &mut self.content {
            Content::Live(live) => {
                let frames = self.clock.frames(seconds, live.setup().units.frame_time_s);
                (0..frames).try_for_each(|_| live.step())?;
                live.poll()?;
            }
            Content::Playback(playback, _) => {
                let frames = self.clock.frames(seconds, 1.0 / playback.trajectory().fps());
                self.clock.playing &= frames == 0 || playback.advance(frames);
            }
        }
        self.note_frames();
        Ok(())
    }

    fn note_frames(&mut self) {
        let Content::Live(live) = &mut self.content else { return };
        for (_, stats) in live.take_news() {
            self.history.energy.push(live.joules(stats.energy.total()) as f32);
            let ratio = stats.gradient_last / stats.gradient_first.max(f64::MIN_POSITIVE);
            self.history.gradient.push(ratio as f32);
        }
        self.clock.playing &= live.broken().is_none();
    }

    fn record(&mut self) -> Result<()> {
        let Content::Live(live) = &mut self.content else { return Ok(()) };
        if live.recorder().is_none() {
            let recorder = Recorder::new(&self.out, live.setup())?;
            live.record(recorder)?;
            self.panel.note = "recording".into();
        }
        Ok(())
    }

    /// Ends a recording and writes its file, if one is in progress. Fails if it cannot be written.
    pub fn end_recording(&mut self) -> Result<()> {
        let Content::Live(live) = &mut self.content else { return Ok(()) };
        let Some(recorder) = live.end_recording()? else { return Ok(()) };
        self.panel.note = match recorder.finish()? {
            Some(path) => {
                let note = format!("wrote {}", path.display());
                self.files.push(path);
                note
            }
            None => "a recording without frames was not written".into(),
        };
        self.note_frames();
        Ok(())
    }

    fn write_picture(&mut self) -> Result<()> {
        create_folder(&self.out)?;
        let path = self.out.join(format!("{}.png", free_name(&self.out, "view", "png")));
        write_png(&path, &self.picture(self.size)?)?;
        self.panel.note = format!("wrote {}", path.display());
        self.files.push(path);
        Ok(())
    }

    /// Draws what is shown into a picture of its own.
    fn picture(&mut self, size: [u32; 2]) -> Result<Image> {
        let offscreen = Offscreen::of_format(&self.context, size, self.format)?;
        self.paint(offscreen.view(), offscreen.size());
        offscreen.image()
    }

    fn paint(&mut self, target: &wgpu::TextureView, size: [u32; 2]) {
        let rotation = self.orbit.rotation();
        let lights = Lights::new(rotation * self.orbit.up(), self.facing);
        let screen = ScreenDescriptor { size_in_pixels: size, pixels_per_point: self.scale };
        let Self { context, content, painter, renderer, jobs, orbit, area, .. } = self;
        let (cloth, bodies, markers) = match &*content {
            Content::Live(live) => (live.mesh(), live.placed(), live.markers()),
            Content::Playback(playback, _) => (playback.mesh(), Vec::new(), Vec::new()),
        };
        let mut encoder = context.device.create_command_encoder(&Default::default());
        if let Content::Live(live) = &*content {
            live.record_vertices(&mut encoder);
        }
        let shown = Shown { cloth, bodies: &bodies, markers: &markers };
        painter.draw(&mut encoder, (target, size), (area.within(size), orbit, &lights), &shown);
        let commands = renderer.update_buffers(&context.device, &context.queue, &mut encoder, jobs, &screen);
        let mut pass = encoder
            .begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("panel"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: target,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
                })],
                ..Default::default()
            })
            .forget_lifetime();
        renderer.render(&mut pass, jobs, &screen);
        drop(pass);
        context.queue.submit(commands.into_iter().chain([encoder.finish()]));
    }
}

/// Returns what is to be seen at the start: the cloth, and where its handles will go.
fn seen(content: &Content, positions: &[[f32; 3]]) -> Vec<Vec3> {
    let mut points: Vec<Vec3> = positions.iter().map(|&p| Vec3::from(p)).collect();
    match content {
        Content::Live(live) => points.extend(live.reach()),
        Content::Playback(playback, _) => {
            let every = (playback.trajectory().frames() / 50).max(1);
            let frames = (0..playback.trajectory().frames()).step_by(every);
            points.extend(frames.flat_map(|k| playback.trajectory().frame(k).iter().map(|&p| Vec3::from(p))));
        }
    }
    points
}
