//! The window: it brings events to the viewer and shows its pictures.

use super::{Content, Viewer};
use crate::gpu::{AdapterChoice, Context};
use crate::{Error, Result};
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use winit::application::ApplicationHandler;
use winit::dpi::{LogicalSize, PhysicalSize};
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::window::{Window, WindowId};

/// How long a window in which nothing moves waits before it looks whether it is to close.
const IDLE: Duration = Duration::from_millis(100);

/// How long a window that cannot be drawn into waits before it is tried again.
const LATE: Duration = Duration::from_millis(20);

type Open<'a> = Box<dyn FnOnce(Context) -> Result<(Context, Content)> + 'a>;

/// Shows a window of this title and size \[points\] until it is closed or `closing` is set, and returns the files that were
/// written from it; a recording in progress ends with it. `open` makes what is shown on the device that the window draws with,
/// which it may adjust.
///
/// Fails if there is no display or no adapter that can draw on it, if the device is lost, or as `open` does. Panics if it is not
/// called on the main thread, or a second time.
pub fn run(
    (title, size): (&str, [u32; 2]),
    adapter: &AdapterChoice,
    out: &Path,
    closing: &AtomicBool,
    open: impl FnOnce(Context) -> Result<(Context, Content)>,
) -> Result<Vec<PathBuf>> {
    let events = EventLoop::new().map_err(|error| {
        Error::Device(format!("cannot open a window: {} (--screenshot draws without one)", cause(&error)))
    })?;
    let mut shell = Shell {
        title,
        size,
        adapter,
        out,
        closing,
        open: Some(Box::new(open)),
        shown: None,
        files: Vec::new(),
        failure: None,
    };
    let ended = events.run_app(&mut shell);
    // Also if the loop has failed.
    shell.close();
    match (shell.failure, ended) {
        (Some(error), _) => Err(error),
        (None, Err(error)) => Err(Error::Device(format!("the window has ended: {error}"))),
        (None, Ok(())) => Ok(shell.files),
    }
}

/// Returns what an error of the system says, without the line of the library that met it.
fn cause(error: &dyn Display) -> String {
    let text = error.to_string();
    match text.split_once(": ") {
        Some((place, cause)) if place.starts_with("os error at ") => cause.to_owned(),
        _ => text,
    }
}

struct Shell<'a> {
    title: &'a str,
    size: [u32; 2],
    adapter: &'a AdapterChoice,
    out: &'a Path,
    closing: &'a AtomicBool,
    open: Option<Open<'a>>,
    shown: Option<Shown>,
    files: Vec<PathBuf>,
    failure: Option<Error>,
}

/// A window that is open.
struct Shown {
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    context: Context,
    input: egui_winit::State,
    viewer: Viewer,
    last: Instant,
}

impl ApplicationHandler for Shell<'_> {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        let Some(open) = self.open.take() else { return };
        match Shown::open(events, (self.title, self.size), (self.adapter, self.out), open) {
            Ok(shown) => self.shown = Some(shown),
            Err(error) => self.fail(events, error),
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(shown) = &mut self.shown else { return };
        let response = shown.input.on_window_event(&shown.window, &event);
        if response.repaint {
            shown.window.request_redraw();
        }
        match event {
            WindowEvent::CloseRequested => events.exit(),
            WindowEvent::Resized(size) => shown.resize(size),
            WindowEvent::RedrawRequested => {
                if let Err(error) = shown.draw() {
                    self.fail(events, error);
                }
            }
            _ => {}
        }
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        if self.closing.load(Ordering::Relaxed) {
            events.exit();
        }
        let moving = self.shown.as_ref().filter(|shown| shown.viewer.is_moving());
        events.set_control_flow(match moving {
            Some(shown) => {
                shown.window.request_redraw();
                ControlFlow::Poll
            }
            None => ControlFlow::WaitUntil(Instant::now() + IDLE),
        });
    }

    fn exiting(&mut self, _: &ActiveEventLoop) {
        self.close();
    }
}

impl Shell<'_> {
    fn fail(&mut self, events: &ActiveEventLoop, error: Error) {
        self.failure.get_or_insert(error);
        events.exit();
    }

    /// Ends a recording, and closes the window.
    fn close(&mut self) {
        let Some(mut shown) = self.shown.take() else { return };
        if let Err(error) = shown.viewer.end_recording() {
            self.failure.get_or_insert(error);
        }
        self.files = shown.viewer.files().to_vec();
    }
}

impl Shown {
    fn open(
        events: &ActiveEventLoop,
        (title, [width, height]): (&str, [u32; 2]),
        (adapter, out): (&AdapterChoice, &Path),
        open: Open<'_>,
    ) -> Result<Self> {
        let attributes =
            Window::default_attributes().with_title(title).with_inner_size(LogicalSize::new(width, height));
        let refused = |error: &dyn Display| Error::Device(format!("cannot open a window: {}", cause(error)));
        let window = Arc::new(events.create_window(attributes).map_err(|error| refused(&error))?);
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        let surface = instance.create_surface(window.clone()).map_err(|error| refused(&error))?;
        let (context, adapter) = Context::for_surface(&instance, &surface, adapter)?;
        let size = window.inner_size();
        let config = surface.get_default_config(&adapter, size.width.max(1), size.height.max(1));
        let mut config = config.ok_or_else(|| refused(&"the adapter shows nothing in it"))?;
        // Its shaders encode colours themselves.
        config.format = config.format.remove_srgb_suffix();
        let formats = surface.get_capabilities(&adapter).formats;
        if !formats.contains(&config.format) {
            let plain = formats.iter().find(|format| !format.is_srgb());
            config.format = *plain.ok_or_else(|| refused(&"it has no plain 8-bit format"))?;
        }
        config.present_mode = wgpu::PresentMode::AutoVsync;
        surface.configure(&context.device, &config);
        let (context, content) = open(context)?;
        let viewer = Viewer::new(&context, content, (config.format, [config.width, config.height]), out)?;
        let most = context.device.limits().max_texture_dimension_2d as usize;
        let (egui, root) = (viewer.egui().clone(), egui::ViewportId::ROOT);
        let input =
            egui_winit::State::new(egui, root, &window, Some(window.scale_factor() as f32), None, Some(most));
        window.request_redraw();
        Ok(Self { window, surface, config, context, input, viewer, last: Instant::now() })
    }

    fn resize(&mut self, size: PhysicalSize<u32>) {
        (self.config.width, self.config.height) = (size.width.max(1), size.height.max(1));
        self.surface.configure(&self.context.device, &self.config);
        self.window.request_redraw();
    }

    fn draw(&mut self) -> Result<()> {
        use wgpu::CurrentSurfaceTexture::{Lost, Outdated, Suboptimal, Success};
        let target = match self.surface.get_current_texture() {
            Success(target) | Suboptimal(target) => target,
            Outdated | Lost => {
                self.surface.configure(&self.context.device, &self.config);
                return Ok(());
            }
            // It is covered, or late; it is not asked again at once.
            _ => {
                std::thread::sleep(LATE);
                return Ok(());
            }
        };
        let elapsed = self.last.elapsed();
        self.last = Instant::now();
        let view = target.texture.create_view(&Default::default());
        let input = self.input.take_egui_input(&self.window);
        let size = [target.texture.width(), target.texture.height()];
        let output = self.viewer.frame(input, (&view, size), elapsed)?;
        self.input.handle_platform_output(&self.window, output);
        self.window.pre_present_notify();
        self.context.queue.present(target);
        Ok(())
    }
}
