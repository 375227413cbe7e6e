//! The engine's side: a device, a queue, a pipeline and a render target (a texture, since there is no
//! window).

mod draw;

use draw::{Look, Targets};
use fnopt::gpu::{Context, Tensor};
use fnopt::wgpu::{self, util::DeviceExt};

/// The engine.
pub struct Host {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub pipeline: wgpu::RenderPipeline,
    /// The second vertex buffer: how the sheet is seen.
    pub look: wgpu::Buffer,
    target: wgpu::Texture,
    view: wgpu::TextureView,
}

const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
const SIZE: u32 = 256;
/// Along the x axis from its negative end, z to the right and y up: a view 2.5 m across, with a light behind the eye.
const LOOK: Look = Look {
    clip: [[0.0, 0.0, 0.1, 0.0], [0.0, 0.8, 0.0, 0.0], [0.8, 0.0, 0.0, 0.0], [0.0, 0.0, 0.5, 1.0]],
    light: [-0.96, 0.28, 0.0],
    colour: draw::CLOTH,
};

impl Host {
    /// Opens a device with the limits of its adapter and the features that fnopt can use. WebGPU's default
    /// limits bind at most 128 MiB; without the features there is no half precision, no timing and no
    /// pipeline cache.
    pub fn open() -> Result<Self, Box<dyn std::error::Error>> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()))?;
        let descriptor = wgpu::DeviceDescriptor {
            required_features: adapter.features() & Context::optional_features(),
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))?;
        let pipeline = draw::pipeline(&device, Targets { format: FORMAT, depth: None, samples: 1 });
        let look = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            contents: bytemuck::bytes_of(&LOOK),
            usage: wgpu::BufferUsages::VERTEX,
        });
        let target = device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width: SIZE, height: SIZE, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: FORMAT,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = target.create_view(&Default::default());
        Ok(Self { device, queue, pipeline, look, target, view })
    }

    /// Returns an index buffer.
    pub fn index_buffer(&self, vertices: &[u32]) -> wgpu::Buffer {
        self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            contents: bytemuck::cast_slice(vertices),
            usage: wgpu::BufferUsages::INDEX,
        })
    }

    /// Returns the render target, cleared to transparent black, as an attachment.
    pub fn attachment(&self) -> wgpu::RenderPassColorAttachment<'_> {
        let ops = wgpu::Operations::default();
        wgpu::RenderPassColorAttachment { view: &self.view, depth_slice: None, resolve_target: None, ops }
    }

    /// Returns the pixels of the target, four bytes each.
    pub fn pixels(&self, context: &Context) -> fnopt::Result<Vec<u32>> {
        let picture = Tensor::zeros(context, "picture", &[SIZE as usize, SIZE as usize])?;
        let layout =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * SIZE), rows_per_image: None };
        let to = wgpu::TexelCopyBufferInfo { buffer: picture.buffer(), layout };
        context.submit(|e| e.copy_texture_to_buffer(self.target.as_image_copy(), to, self.target.size()));
        picture.read(context)
    }
}
