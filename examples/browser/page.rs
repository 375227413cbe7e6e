//! The page: a canvas with the sheet, and a line about the last frame.

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

/// Looks along the x axis, y up, at a view 2.5 m across, with a light behind the eye.
const SHADER: &str = "
struct Corner { @builtin(position) place: vec4f, @location(0) normal: vec3f }
@vertex fn corner(@location(0) p: vec3f, @location(1) normal: vec3f) -> Corner {
    return Corner(vec4f(-0.8 * p.z, 0.8 * p.y, 0.5 + 0.1 * p.x, 1.0), normal);
}
@fragment fn colour(@location(0) normal: vec3f) -> @location(0) vec4f {
    let n = normalize(normal);
    return vec4f(vec3f(0.28, 0.45, 0.62) * (0.45 + 0.5 * abs(n.x) + 0.15 * n.y), 1.0);
}";
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
            pipeline: pipeline(&device, shown.format),
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

/// Builds a pipeline that draws triangles from positions and normals in one vertex buffer.
fn pipeline(device: &wgpu::Device, format: wgpu::TextureFormat) -> wgpu::RenderPipeline {
    let source = wgpu::ShaderSource::Wgsl(SHADER.into());
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
    let attributes = &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3];
    let step_mode = wgpu::VertexStepMode::Vertex;
    let buffer = wgpu::VertexBufferLayout { array_stride: Vertices::STRIDE, step_mode, attributes };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: None,
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: None,
            compilation_options: Default::default(),
            buffers: &[Some(buffer)],
        },
        primitive: Default::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Less),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: None,
            compilation_options: Default::default(),
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
