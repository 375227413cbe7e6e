//! The page: a canvas with the sheet, and a line about the last frame.

use crate::draw::pipeline;
use fnopt::gpu::{Context, Readback};
use fnopt::network::Weights;
use fnopt::scene::{Scene, Setup};
use fnopt::sim::{Optimizer, Solver, Vertices};
use fnopt::wgpu::{self, util::DeviceExt};
use std::cell::RefCell;
use std::error::Error;
use std::rc::Rc;
use wasm_bindgen::JsCast;
use wasm_bindgen::closure::Closure;

const BACKGROUND: wgpu::Color = wgpu::Color { r: 0.957, g: 0.957, b: 0.949, a: 1.0 };
const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth24Plus;

/// Starts the simulation; errors are shown in place of the line.
pub fn start() {
    std::panic::set_hook(Box::new(|panic| say(&panic.to_string())));
    wasm_bindgen_futures::spawn_local(async {
        match Page::open().await {
            Ok(page) => run(page),
            Err(error) => say(&error.to_string()),
        }
    });
}

fn document() -> web_sys::Document {
    web_sys::window().and_then(|window| window.document()).expect("a page has a document")
}

fn say(line: &str) {
    let place = document().query_selector("p").ok().flatten();
    place.expect("the page has a line of text").set_text_content(Some(line));
}

/// Computes and draws a frame whenever the browser is about to show one.
fn run(mut page: Page) {
    type Callback = Closure<dyn FnMut()>;
    fn ask(callback: &Callback) {
        let window = web_sys::window().expect("a page has a window");
        let asked = window.request_animation_frame(callback.as_ref().unchecked_ref());
        asked.expect("a window shows frames");
    }
    let callback: Rc<RefCell<Option<Callback>>> = Rc::default();
    let again = callback.clone();
    *callback.borrow_mut() = Some(Closure::new(move || match page.frame() {
        Ok(()) => ask(again.borrow().as_ref().expect("it was set before it was called")),
        Err(error) => say(&error.to_string()),
    }));
    ask(callback.borrow().as_ref().expect("it was just set"));
}

struct Page {
    surface: wgpu::Surface<'static>,
    context: Context,
    setup: Setup,
    solver: Solver,
    vertices: Vertices,
    indices: wgpu::Buffer,
    pipeline: wgpu::RenderPipeline,
    depth: wgpu::TextureView,
    /// Brings the statistics of a frame to the host some frames later.
    readback: Readback,
    /// Number of the last frame computed, and of the last whose statistics have arrived.
    computed: usize,
    arrived: usize,
}

impl Page {
    async fn open() -> Result<Self, Box<dyn Error>> {
        let canvas = document().query_selector("canvas").ok().flatten().ok_or("the page has no canvas")?;
        let canvas: web_sys::HtmlCanvasElement = canvas.dyn_into().map_err(|_| "not a canvas")?;
        let (width, height) = (canvas.width(), canvas.height());
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let surface = instance.create_surface(wgpu::SurfaceTarget::Canvas(canvas))?;
        let options =
            wgpu::RequestAdapterOptions { compatible_surface: Some(&surface), ..Default::default() };
        let adapter = instance.request_adapter(&options).await?;
        let descriptor = wgpu::DeviceDescriptor {
            required_features: adapter.features() & Context::optional_features(),
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = adapter.request_device(&descriptor).await?;
        let shown = surface.get_default_config(&adapter, width, height).ok_or("the canvas shows nothing")?;
        surface.configure(&device, &shown);

        let context = Context::new(device.clone(), queue)?;
        let setup = Scene::default().setup()?;
        let optimizer = Optimizer::learned(Weights::shipped());
        let solver = Solver::new(&context, &setup.model, &optimizer, 10)?;
        solver.set_state(&setup.start.cast());
        let vertices = solver.vertices()?;
        vertices.set_view(&setup.vertex_view());
        let indices = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            contents: bytemuck::cast_slice(&setup.model.grid.faces()),
            usage: wgpu::BufferUsages::INDEX,
        });
        let depth = device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: DEPTH,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        let readback = Readback::new(&context, &solver.statistics_tensors(), 3)?;
        Ok(Self {
            pipeline: pipeline(&device, shown.format, Some(DEPTH)),
            depth: depth.create_view(&Default::default()),
            surface,
            context,
            setup,
            solver,
            vertices,
            indices,
            readback,
            computed: 0,
            arrived: 0,
        })
    }

    fn frame(&mut self) -> Result<(), Box<dyn Error>> {
        while let Some(stats) = self.readback.try_next(|bytes| self.solver.statistics(bytes))? {
            self.arrived += 1;
            let [cloth] = &stats[..] else { unreachable!("one cloth") };
            let line = format!("frame {}, energy {:.6}", self.arrived, cloth.energy.total());
            say(&format!("{line} ({})", self.context.name()));
        }
        if self.computed + 1 == self.setup.frames() {
            // The motion begins again once everything about the last run has been said.
            if self.arrived == self.computed {
                (self.computed, self.arrived) = (0, 0);
                self.solver.set_state(&self.setup.start.cast());
            }
            return Ok(());
        }
        // The device is behind; the canvas keeps its picture.
        if self.readback.is_full() {
            return Ok(());
        }
        use wgpu::CurrentSurfaceTexture::{Suboptimal, Success};
        let (Success(target) | Suboptimal(target)) = self.surface.get_current_texture() else {
            return Ok(());
        };
        self.computed += 1;
        self.solver.set_control(&self.setup.control(self.computed));
        let view = target.texture.create_view(&Default::default());
        let submission = self.context.submit(|encoder| {
            self.solver.record(encoder);
            self.readback.record(encoder);
            self.vertices.record(encoder);
            let load = wgpu::LoadOp::Clear(BACKGROUND);
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &self.depth,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(1.0),
                        store: wgpu::StoreOp::Discard,
                    }),
                    stencil_ops: None,
                }),
                ..Default::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_vertex_buffer(0, self.vertices.tensor().buffer().slice(..));
            pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
            pass.draw_indexed(0..3 * self.setup.model.grid.faces().len() as u32, 0, 0..1);
        });
        self.readback.submitted(&submission);
        self.context.queue.present(target);
        Ok(())
    }
}
