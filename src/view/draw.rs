//! The pipelines of the viewer: what it draws around and below its panel.

use super::camera::Orbit;
use super::solids::{Corner, Solid};
use crate::render::shared::{
    BACK, BACKGROUND, BODY, FRONT, HANDLE, Lights, MARKER, PLANE, TANGENT, fields_per_edge,
};
use crate::sim::Vertices;
use bytemuck::{Pod, Zeroable};
use glam::{Mat3, Vec3};
use wgpu::util::DeviceExt;

/// Samples per pixel.
const SAMPLES: u32 = 4;
const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// A handle that is being dragged: yellow.
const DRAG: Vec3 = Vec3::new(0.98, 0.72, 0.04);
/// Distance of the nearest plane that is drawn, as a share of the distance of the eye.
const NEAR: f32 = 0.01;

/// The part of a picture that shows the cloth \[px\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Area {
    /// Its left upper corner.
    pub corner: [f32; 2],
    /// Its width and height.
    pub size: [f32; 2],
}

impl Area {
    /// Returns the part of it that lies in a picture of this size.
    pub(super) fn within(self, size: [u32; 2]) -> Self {
        let side = |axis: usize| self.size[axis].min(size[axis] as f32 - self.corner[axis]).max(0.0);
        Self { size: [side(0), side(1)], ..self }
    }
}

/// What the shader of all objects reads.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Stage {
    rotation: [[f32; 4]; 3],
    eye: [f32; 3],
    near: f32,
    scale: [f32; 2],
    marker: f32,
    width: u32,
    key: [f32; 3],
    fields: f32,
    fill: [f32; 4],
    up: [f32; 4],
    colours: [[f32; 4]; 8],
}

/// A marker of a handle: its place \[m\], and 1 for one that is being dragged, else 0.
pub(super) type Marker = [f32; 4];

/// A body in one frame: columns of its rotation, each with a component of its position, and the patch of a plane.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(super) struct Placed {
    pub columns: [[f32; 4]; 3],
    pub patch: [f32; 4],
}

/// A mesh on the device whose vertices are positions and normals.
pub(super) struct Mesh {
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    count: u32,
    /// The width of the grid that the vertices form, and checker fields per edge; 0 for none.
    checker: (usize, f32),
}

impl Mesh {
    /// Returns the mesh of a cloth, whose vertices others write. Those of a grid of height and width `grid` have a checker.
    pub fn of_cloth(
        device: &wgpu::Device,
        vertices: wgpu::Buffer,
        faces: &[[u32; 3]],
        grid: Option<[usize; 2]>,
    ) -> Self {
        let checker = grid.map_or((1, 0.0), |[h, w]| (w, fields_per_edge(h.max(w) - 1)));
        Self { vertices, indices: indices(device, faces), count: 3 * faces.len() as u32, checker }
    }

    /// Returns the mesh of a body.
    pub fn of_body(device: &wgpu::Device, solid: &Solid) -> Self {
        let contents = bytemuck::cast_slice::<Corner, u8>(&solid.corners);
        let usage = wgpu::BufferUsages::VERTEX;
        let descriptor = wgpu::util::BufferInitDescriptor { label: Some("body"), contents, usage };
        let (faces, checker) = (&solid.faces, (1, 0.0));
        let vertices = device.create_buffer_init(&descriptor);
        Self { vertices, indices: indices(device, faces), count: 3 * faces.len() as u32, checker }
    }
}

fn indices(device: &wgpu::Device, faces: &[[u32; 3]]) -> wgpu::Buffer {
    device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some("faces"),
        contents: bytemuck::cast_slice(faces),
        usage: wgpu::BufferUsages::INDEX,
    })
}

/// What a picture shows.
pub(super) struct Shown<'a> {
    pub cloth: &'a Mesh,
    /// The bodies that are there, each with its mesh and whether it is a plane.
    pub bodies: &'a [(&'a Mesh, Placed, bool)],
    pub markers: &'a [Marker],
}

/// Draws cloths with bodies and markers into pictures of one format.
pub(super) struct Painter {
    device: wgpu::Device,
    queue: wgpu::Queue,
    format: wgpu::TextureFormat,
    stage: wgpu::Buffer,
    bindings: wgpu::BindGroup,
    wall: wgpu::RenderPipeline,
    cloth: wgpu::RenderPipeline,
    body: wgpu::RenderPipeline,
    plane: wgpu::RenderPipeline,
    marker: wgpu::RenderPipeline,
    /// Several samples per pixel, and their depths, for pictures of this size.
    samples: Option<([u32; 2], [wgpu::TextureView; 2])>,
}

impl Painter {
    pub fn new(device: &wgpu::Device, queue: &wgpu::Queue, format: wgpu::TextureFormat) -> Self {
        let source = wgpu::ShaderSource::Wgsl(include_str!("stage.wgsl").into());
        let module =
            device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some("view"), source });
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("stage"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            }],
        });
        let stage = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("stage"),
            size: size_of::<Stage>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("stage"),
            layout: &layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: stage.as_entire_binding() }],
        });
        let pipelines = Pipelines { device, module: &module, layout: &layout, format };
        let corner = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3];
        let pose = wgpu::vertex_attr_array![2 => Float32x4, 3 => Float32x4, 4 => Float32x4, 5 => Float32x4];
        let place = wgpu::vertex_attr_array![0 => Float32x4];
        let per = |array_stride: usize, step_mode, attributes| {
            Some(wgpu::VertexBufferLayout { array_stride: array_stride as u64, step_mode, attributes })
        };
        let corners = per(Vertices::STRIDE as usize, wgpu::VertexStepMode::Vertex, &corner);
        let poses = per(size_of::<Placed>(), wgpu::VertexStepMode::Instance, &pose);
        let places = per(size_of::<Marker>(), wgpu::VertexStepMode::Instance, &place);
        let opaque = |entries, buffers: &[_]| pipelines.build(entries, buffers, Kind::Opaque);
        Self {
            wall: pipelines.build(["wall", "wall_colour"], &[], Kind::Behind),
            cloth: opaque(["cloth", "cloth_colour"], std::slice::from_ref(&corners)),
            body: opaque(["body", "body_colour"], &[corners.clone(), poses.clone()]),
            plane: pipelines.build(["body", "plane_colour"], &[corners, poses], Kind::Blended),
            marker: pipelines.build(["marker", "marker_colour"], &[places], Kind::Square),
            device: device.clone(),
            queue: queue.clone(),
            format,
            stage,
            bindings,
            samples: None,
        }
    }

    /// Draws into `target`, a picture of `size` pixels, of which the cloth gets an area.
    pub fn draw(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        (target, size): (&wgpu::TextureView, [u32; 2]),
        (area, orbit, lights): (Area, &Orbit, &Lights),
        shown: &Shown<'_>,
    ) {
        let stage = stage(orbit, area, lights, shown.cloth.checker);
        self.queue.write_buffer(&self.stage, 0, bytemuck::bytes_of(&stage));
        let placed: Vec<Placed> = shown.bodies.iter().map(|(_, placed, _)| *placed).collect();
        let (placed, markers) = (self.instances(&placed), self.instances(shown.markers));
        let [samples, depth] = self.samples(size);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("cloth"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &samples,
                depth_slice: None,
                resolve_target: Some(target),
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Discard,
                },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        let ([x, y], [width, height]) = (area.corner, area.size);
        if width < 1.0 || height < 1.0 {
            return;
        }
        pass.set_viewport(x, y, width, height, 0.0, 1.0);
        pass.set_bind_group(0, &self.bindings, &[]);
        pass.set_pipeline(&self.wall);
        pass.draw(0..3, 0..1);
        pass.set_pipeline(&self.cloth);
        draw_mesh(&mut pass, shown.cloth, 0);
        if let Some(placed) = &placed {
            pass.set_vertex_buffer(1, placed.slice(..));
            let bodies = || (0..).zip(shown.bodies);
            pass.set_pipeline(&self.body);
            bodies().filter(|(_, body)| !body.2).for_each(|(k, body)| draw_mesh(&mut pass, body.0, k));
            // These are blended over what is behind them.
            pass.set_pipeline(&self.plane);
            bodies().filter(|(_, body)| body.2).for_each(|(k, body)| draw_mesh(&mut pass, body.0, k));
        }
        if let Some(markers) = &markers {
            pass.set_pipeline(&self.marker);
            pass.set_vertex_buffer(0, markers.slice(..));
            pass.draw(0..4, 0..shown.markers.len() as u32);
        }
    }

    /// Returns a buffer with one entry per instance; `None` if there are none.
    fn instances<T: Pod>(&self, all: &[T]) -> Option<wgpu::Buffer> {
        let descriptor = wgpu::util::BufferInitDescriptor {
            label: Some("instances"),
            contents: bytemuck::cast_slice(all),
            usage: wgpu::BufferUsages::VERTEX,
        };
        (!all.is_empty()).then(|| self.device.create_buffer_init(&descriptor))
    }

    fn samples(&mut self, size: [u32; 2]) -> [wgpu::TextureView; 2] {
        if let Some((_, views)) = self.samples.as_ref().filter(|(own, _)| *own == size) {
            return views.clone();
        }
        let views = [self.format, DEPTH].map(|format| {
            let texture = self.device.create_texture(&wgpu::TextureDescriptor {
                label: Some("samples"),
                size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: SAMPLES,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
                view_formats: &[],
            });
            texture.create_view(&Default::default())
        });
        self.samples = Some((size, views.clone()));
        views
    }
}

fn draw_mesh(pass: &mut wgpu::RenderPass<'_>, mesh: &Mesh, instance: u32) {
    pass.set_vertex_buffer(0, mesh.vertices.slice(..));
    pass.set_index_buffer(mesh.indices.slice(..), wgpu::IndexFormat::Uint32);
    pass.draw_indexed(0..mesh.count, 0, instance..instance + 1);
}

fn stage(orbit: &Orbit, area: Area, lights: &Lights, (width, fields): (usize, f32)) -> Stage {
    let camera = orbit.camera(area.size);
    let colours = [FRONT, BACK, HANDLE, DRAG, BODY, PLANE, BACKGROUND[0], BACKGROUND[1]];
    Stage {
        rotation: columns(camera.rotation),
        eye: camera.eye().to_array(),
        near: NEAR * orbit.distance,
        scale: area.size.map(|side| 2.0 * camera.focal / side.max(1.0)),
        marker: 2.0 * TANGENT * MARKER,
        width: width as u32,
        key: lights.key.to_array(),
        fields,
        fill: lights.fill.extend(0.0).to_array(),
        up: lights.up.extend(0.0).to_array(),
        colours: colours.map(|colour| colour.extend(1.0).to_array()),
    }
}

fn columns(rotation: Mat3) -> [[f32; 4]; 3] {
    [rotation.x_axis, rotation.y_axis, rotation.z_axis].map(|axis| axis.extend(0.0).to_array())
}

/// How what is drawn covers what is there.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Behind,
    Opaque,
    Blended,
    Square,
}

struct Pipelines<'a> {
    device: &'a wgpu::Device,
    module: &'a wgpu::ShaderModule,
    layout: &'a wgpu::BindGroupLayout,
    format: wgpu::TextureFormat,
}

impl Pipelines<'_> {
    fn build(
        &self,
        [vertex, fragment]: [&str; 2],
        buffers: &[Option<wgpu::VertexBufferLayout<'_>>],
        kind: Kind,
    ) -> wgpu::RenderPipeline {
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(vertex),
            bind_group_layouts: &[Some(self.layout)],
            immediate_size: 0,
        });
        let topology = match kind {
            Kind::Square => wgpu::PrimitiveTopology::TriangleStrip,
            _ => wgpu::PrimitiveTopology::TriangleList,
        };
        let blend = (kind == Kind::Blended).then_some(wgpu::BlendState::ALPHA_BLENDING);
        let depth_compare =
            if kind == Kind::Behind { wgpu::CompareFunction::Always } else { wgpu::CompareFunction::Greater };
        self.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(vertex),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: self.module,
                entry_point: Some(vertex),
                compilation_options: Default::default(),
                buffers,
            },
            primitive: wgpu::PrimitiveState { topology, ..Default::default() },
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH,
                depth_write_enabled: Some(matches!(kind, Kind::Opaque | Kind::Square)),
                depth_compare: Some(depth_compare),
                stencil: Default::default(),
                bias: Default::default(),
            }),
            multisample: wgpu::MultisampleState { count: SAMPLES, ..Default::default() },
            fragment: Some(wgpu::FragmentState {
                module: self.module,
                entry_point: Some(fragment),
                compilation_options: Default::default(),
                targets: &[Some(wgpu::ColorTargetState {
                    format: self.format,
                    blend,
                    write_mask: wgpu::ColorWrites::ALL,
                })],
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use naga::valid::{Capabilities, ValidationFlags, Validator};

    #[test]
    fn the_shader_is_valid() {
        let module = naga::front::wgsl::parse_str(include_str!("stage.wgsl")).unwrap();
        Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).unwrap();
    }
}
