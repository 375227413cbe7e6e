//! How the engine draws: triangles from positions and normals in one vertex buffer.

use fnopt::sim::Vertices;
use fnopt::wgpu;

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

/// Builds the pipeline for targets of these formats; without a depth, later triangles cover earlier ones.
pub fn pipeline(
    device: &wgpu::Device,
    format: wgpu::TextureFormat,
    depth: Option<wgpu::TextureFormat>,
) -> wgpu::RenderPipeline {
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
        depth_stencil: depth.map(|format| wgpu::DepthStencilState {
            format,
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
