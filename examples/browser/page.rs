//! What the page's scripts call. Text goes to and fro as JSON; places on the canvas are parts of its width from the left and
//! of its height from above.

use crate::camera::Camera;
use crate::notices::Notices;
use crate::scenes;
use crate::session::{Request, Session};
use crate::view::{Meshes, View};
use fnopt::glam::{DVec2, DVec3};
use fnopt::gpu::Context;
use fnopt::serde_json::{Value, json};
use fnopt::wgpu;
use std::cell::RefCell;
use wasm_bindgen::prelude::wasm_bindgen;
use wasm_bindgen::{JsCast, JsError};

/// How near a handle must be to be grabbed, in the smaller side of the canvas.
const REACH: f64 = 0.06;

thread_local!(static PANIC: RefCell<String> = const { RefCell::new(String::new()) });

/// Keeps the text of a panic, which ends the module.
pub fn keep_panics() {
    std::panic::set_hook(Box::new(|panic| PANIC.with(|text| *text.borrow_mut() = panic.to_string())));
}

/// Returns the text of the panic that ended the module.
#[wasm_bindgen]
pub fn panicked() -> String {
    PANIC.with(|text| text.borrow().clone())
}

/// A canvas with a scene.
#[wasm_bindgen]
pub struct Page {
    context: Context,
    notices: Notices,
    view: View,
    camera: Camera,
    running: Option<(Session, Meshes)>,
    /// The handle that was chosen or grabbed last.
    chosen: Option<usize>,
    /// A handle on its way, where it is to be, and whether it is still held.
    pulled: Option<(usize, DVec3, bool)>,
    /// Whether the canvas no longer shows what is there.
    stale: bool,
}

fn failed(error: impl std::fmt::Display) -> JsError {
    JsError::new(&error.to_string())
}

#[wasm_bindgen]
impl Page {
    /// Opens the device, to draw on this canvas.
    pub async fn open(canvas: web_sys::HtmlCanvasElement) -> Result<Page, JsError> {
        let (width, height) = (canvas.width().max(1), canvas.height().max(1));
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let target = wgpu::SurfaceTarget::Canvas(canvas.unchecked_into());
        let surface = instance.create_surface(target).map_err(failed)?;
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: Some(&surface),
            ..Default::default()
        };
        let adapter = instance.request_adapter(&options).await.map_err(failed)?;
        let descriptor = wgpu::DeviceDescriptor {
            required_features: adapter.features() & Context::optional_features(),
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = adapter.request_device(&descriptor).await.map_err(failed)?;
        let shown = surface.get_default_config(&adapter, width, height);
        let mut shown = shown.ok_or_else(|| failed("the device cannot draw on a canvas"))?;
        shown.alpha_mode = wgpu::CompositeAlphaMode::PreMultiplied;
        let notices = Notices::of(&device);
        let context = Context::new(device.clone(), queue).map_err(failed)?;
        let camera = Camera::on([DVec3::ZERO].into_iter(), f64::from(width) / f64::from(height));
        let view = View::new(&device, surface, shown);
        Ok(Self { context, notices, view, camera, running: None, chosen: None, pulled: None, stale: true })
    }

    /// Returns the name of the device.
    pub fn device(&self) -> String {
        self.context.name().to_owned()
    }

    /// Returns all scenes: `[{"name", "description", "refused", "gallery"}, ..]`, where `refused` is null or why a page cannot
    /// show the scene.
    pub fn scenes(&self) -> String {
        scenes::list().to_string()
    }

    /// Begins a scene with the options `{"solver", "iterations", "grid"}`. If that fails, the scene before it stays.
    pub fn load(&mut self, name: &str, options: &str) -> Result<(), JsError> {
        let request = Request::read(name, options).map_err(failed)?;
        let session = Session::new(&self.context, &request).map_err(failed)?;
        let units = session.setup.units;
        let metres = |at: &[f64; 3]| DVec3::from(units.position_m(*at));
        let n = session.setup.model.grid.particles();
        let handles = session.setup.handles.iter().flatten().map(metres);
        let camera = Camera::on((0..n).map(|p| session.particle(p)).chain(handles), self.camera.aspect);
        let meshes = Meshes::new(&self.context.device, &request.scene, &session, 2.0 * camera.radius());
        (self.camera, self.running) = (camera, Some((session, meshes)));
        (self.chosen, self.pulled, self.stale) = (None, None, true);
        self.notices.forgive();
        Ok(())
    }

    /// Sets `stretch`, `shear` [N/m], `bend` [N m], `density` [kg/m^2], `gravity` [m/s^2], `wind` [m/s] or `wind_direction`
    /// \[degrees\], from the next frame on.
    pub fn set(&mut self, field: &str, value: f64) -> Result<(), JsError> {
        let Some((session, _)) = &mut self.running else { return Ok(()) };
        session.settings.set(field, value).map_err(failed)?;
        session.apply().map_err(failed)
    }

    /// Returns these fields as they are.
    pub fn settings(&self) -> Result<String, JsError> {
        let Some((session, _)) = &self.running else { return Ok("{}".to_owned()) };
        let cloth = session.cloth().map_err(failed)?;
        let wind = session.wind().map_err(failed)?;
        Ok(session.settings.values(&session.setup, cloth, wind).to_string())
    }

    /// Begins the scene again, with the settings as they are.
    pub fn reset(&mut self) -> Result<(), JsError> {
        (self.pulled, self.stale) = (None, true);
        self.notices.forgive();
        match &mut self.running {
            Some((session, _)) => session.reset().map_err(failed),
            None => Ok(()),
        }
    }

    /// Makes the canvas as large as this, in pixels.
    pub fn resize(&mut self, width: u32, height: u32) {
        let size =
            [width, height].map(|side| side.clamp(1, self.context.device.limits().max_texture_dimension_2d));
        if size != self.view.size() {
            self.view.resize(&self.context.device, size);
            self.camera.aspect = f64::from(size[0]) / f64::from(size[1]);
            self.stale = true;
        }
    }

    /// Moves the camera around what it looks at, by angles \[rad\].
    pub fn orbit(&mut self, turn: f64, rise: f64) {
        self.camera.orbit(turn, rise);
        self.stale = true;
    }

    /// Moves the camera nearer by a factor.
    pub fn zoom(&mut self, factor: f64) {
        self.camera.zoom(factor);
        self.stale = true;
    }

    /// Grabs the handle at a place on the canvas, or else the cloth there. Whether there is either.
    pub fn grab(&mut self, x: f64, y: f64) -> Result<bool, JsError> {
        let Some((session, _)) = &mut self.running else { return Ok(false) };
        // In parts of the smaller side, so that near is near both ways.
        let sides = DVec2::new(self.camera.aspect, 1.0) / self.camera.aspect.min(1.0);
        let camera = &self.camera;
        let away = |at: DVec3| Some(((camera.place(at)? - DVec2::new(x, y)) * sides).length());
        let near = session.handles().filter_map(|(p, at)| Some((away(at)?, p, at)));
        let nearest = near.filter(|(away, ..)| *away <= REACH).min_by(|a, b| a.0.total_cmp(&b.0));
        let found = nearest.map(|(_, p, at)| (p, at)).or_else(|| {
            // Of several layers, the one in front.
            let (n, cloth) = (session.setup.model.grid.particles(), &session.setup.model.cloths[0]);
            let particles = (0..n).filter(|p| cloth.contains(*p)).map(|p| (p, session.particle(p)));
            let near = particles.filter(|(_, at)| away(*at).is_some_and(|away| away <= 0.5 * REACH));
            let towards = camera.outward();
            near.max_by(|a, b| a.1.dot(towards).total_cmp(&b.1.dot(towards)))
        });
        let Some((p, at)) = found else { return Ok(false) };
        if !session.handles().any(|(handle, _)| handle == p) {
            session.hold(Some(p)).map_err(failed)?;
        }
        (self.chosen, self.pulled, self.stale) = (Some(p), Some((p, at, true)), true);
        Ok(true)
    }

    /// Moves what was grabbed to a place on the canvas, in the plane through it that faces the camera.
    pub fn drag(&mut self, x: f64, y: f64) {
        if let Some((_, at, true)) = &mut self.pulled {
            *at = self.camera.point(DVec2::new(x, y), *at);
        }
    }

    /// Lets go what was grabbed: a handle stays where the pointer was, as soon as it is there, and the cloth is free again.
    pub fn release(&mut self) -> Result<(), JsError> {
        let (Some((session, _)), Some((p, _, held))) = (&mut self.running, &mut self.pulled) else {
            return Ok(());
        };
        *held = false;
        if session.holds(*p) {
            session.hold(None).map_err(failed)?;
            (self.pulled, self.chosen, self.stale) = (None, None, true);
        }
        Ok(())
    }

    /// Chooses the next handle, or the first one. Its number and how many there are: `[k, n]`, or `[]` without handles.
    pub fn choose(&mut self) -> String {
        let Some((session, _)) = &self.running else { return "[]".to_owned() };
        let handles: Vec<usize> = session.handles().map(|(p, _)| p).collect();
        if handles.is_empty() {
            return "[]".to_owned();
        }
        let last = handles.iter().position(|p| Some(*p) == self.chosen);
        let next = last.map_or(0, |k| (k + 1) % handles.len());
        (self.chosen, self.stale) = (Some(handles[next]), true);
        json!([next + 1, handles.len()]).to_string()
    }

    /// Moves the chosen handle to the right and upwards on the canvas, by parts of what it shows.
    pub fn nudge(&mut self, right: f64, up: f64) {
        let (Some((session, _)), Some(chosen)) = (&self.running, self.chosen) else { return };
        let from = match self.pulled {
            Some((p, at, _)) if p == chosen => Some(at),
            _ => session.handles().find(|(p, _)| *p == chosen).map(|(_, at)| at),
        };
        let [x, y] = self.camera.axes();
        self.pulled = from.map(|at| (chosen, at + 2.0 * self.camera.radius() * (right * x + up * y), false));
    }

    /// Draws what is there, after computing a frame if it is wanted and the device is ready. Whether it computed one.
    pub fn frame(&mut self, wanted: bool) -> bool {
        if self.notices.current().is_some() {
            return false;
        }
        self.try_frame(wanted).unwrap_or_else(|error| {
            let kind = match error {
                fnopt::Error::NonFinite { .. } => "non-finite",
                fnopt::Error::Lost(_) => "lost",
                _ => "error",
            };
            self.notices.fault(kind, &error.to_string());
            false
        })
    }

    fn try_frame(&mut self, wanted: bool) -> fnopt::Result<bool> {
        let Some((session, meshes)) = &mut self.running else { return Ok(false) };
        session.collect()?;
        let wanted = wanted && session.is_ready()?;
        // The device is behind, or nothing has changed; the canvas keeps its picture.
        if !wanted && (!self.stale || session.is_behind()) {
            return Ok(false);
        }
        let Some(target) = self.view.target() else { return Ok(false) };
        if wanted {
            if let Some((p, at, held)) = self.pulled
                && session.pull(p, at)
                && !held
            {
                self.pulled = None;
            }
            session.enter_frame()?;
        }
        let queue = &self.context.queue;
        let submission = self.context.submit(|encoder| {
            if wanted {
                session.record(encoder);
            }
            session.vertices.record(encoder);
            self.view.record((encoder, queue), &target, (session, meshes), (&self.camera, self.chosen));
        });
        if wanted {
            session.submitted(&submission);
            self.notices.time(queue);
        }
        queue.present(target);
        self.stale = false;
        Ok(wanted)
    }

    /// Returns what became of the last frame that has arrived, and why the page cannot go on, if it cannot; see the code for the
    /// fields.
    pub fn status(&self) -> String {
        let fault = self.notices.current().map(|fault| json!({ "kind": fault.kind, "text": fault.text }));
        let Some((session, _)) = &self.running else { return json!({ "fault": fault }).to_string() };
        let (frame, _, stats) = session.latest();
        let setup = &session.setup;
        let grid = setup.model.grid;
        let handles = session.handles().map(|(p, target)| {
            let place = self.camera.place(target).map(|at| [at.x, at.y]);
            json!({ "particle": p, "target_m": target.to_array(), "at_m": session.particle(p).to_array(), "place": place })
        });
        let cloth = &setup.model.cloths[0];
        let heights = (0..grid.particles()).filter(|p| cloth.contains(*p)).map(|p| session.particle(p).z);
        json!({
            "frame": frame,
            "frames": setup.frames(),
            "over": session.is_over(),
            "frame_time_s": setup.units.frame_time_s,
            "grid": [grid.h, grid.w],
            "iterations": session.solver.iterations(),
            "energy": stats.map(|stats| stats.energy.total()),
            "gradient": stats.map(|stats| stats.gradient_last / stats.gradient_first.max(f64::MIN_POSITIVE)),
            "stretch": stats.map(|stats| stats.stretch_largest),
            "lowest_m": heights.fold(f64::INFINITY, f64::min),
            "took_ms": self.notices.took(),
            "handles": handles.collect::<Value>(),
            "fault": fault,
        })
        .to_string()
    }
}
