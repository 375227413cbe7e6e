//! How the engine draws: triangles from positions and normals in one vertex buffer, and from a second one where they are
//! seen and in which colour.

use bytemuck::{Pod, Zeroable};
use fnopt::sim::Vertices;
use fnopt::wgpu;

/// Both sides of a triangle are lit alike.
const SHADER: &str = "
struct Corner { @builtin(position) place: vec4f, @location(0) light: f32, @location(1) colour: vec3f }
@vertex fn corner(
    @location(0) p: vec3f, @location(1) normal: vec3f,
    @location(2) x: vec4f, @location(3) y: vec4f, @location(4) z: vec4f, @location(5) origin: vec4f,
    @location(6) light: vec3f, @location(7) colour: vec3f,
) -> Corner {
    return Corner(x * p.x + y * p.y + z * p.z + origin, dot(normal, light), colour);
}
@fragment fn colour(at: Corner) -> @location(0) vec4f { return vec4f(at.colour * (0.4 + 0.6 * abs(at.light)), 1.0); }";

/// How a mesh is drawn: an element of the second vertex buffer.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Look {
    /// Columns of the matrix from the axes of the vertices to clip space.
    pub clip: [[f32; 4]; 4],
    /// Direction to the light in the axes of the vertices, of length 1.
    pub light: [f32; 3],
    /// Red, green and blue, 0 to 1.
    pub colour: [f32; 3],
}

/// The colour of the cloth.
pub const CLOTH: [f32; 3] = [0.30, 0.49, 0.68];

/// How the pipeline writes into its targets.
#[derive(Clone, Copy, Debug)]
pub struct Targets {
    pub format: wgpu::TextureFormat,
    /// Without a depth, later triangles cover earlier ones.
    pub depth: Option<wgpu::TextureFormat>,
    /// Samples for each pixel, 1 or 4.
    pub samples: u32,
}

/// Builds the pipeline for such targets.
pub fn pipeline(device: &wgpu::Device, targets: Targets) -> wgpu::RenderPipeline {
    let source = wgpu::ShaderSource::Wgsl(SHADER.into());
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
    let of_vertex = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3];
    let of_look = wgpu::vertex_attr_array![
        2 => Float32x4, 3 => Float32x4, 4 => Float32x4, 5 => Float32x4, 6 => Float32x3, 7 => Float32x3
    ];
    let vertices = wgpu::VertexBufferLayout {
        array_stride: Vertices::STRIDE,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes: &of_vertex,
    };
    let looks = wgpu::VertexBufferLayout {
        array_stride: size_of::<Look>() as u64,
        step_mode: wgpu::VertexStepMode::Instance,
        attributes: &of_look,
    };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: None,
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: None,
            compilation_options: Default::default(),
            buffers: &[Some(vertices), Some(looks)],
        },
        primitive: Default::default(),
        depth_stencil: targets.depth.map(|format| wgpu::DepthStencilState {
            format,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Less),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: wgpu::MultisampleState { count: targets.samples, ..Default::default() },
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: None,
            compilation_options: Default::default(),
            targets: &[Some(targets.format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
