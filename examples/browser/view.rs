//! The picture: the cloth, the bodies and the handles of a session on the canvas.

use crate::bodies::{Triangles, capsule, triangles};
use crate::camera::Camera;
use crate::draw::{CLOTH, Look, Targets, pipeline};
use crate::session::Session;
use fnopt::cloth::{MAX_BODIES, Pose};
use fnopt::glam::{DMat3, DMat4, DQuat, DVec3};
use fnopt::wgpu::{self, util::DeviceExt};

const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth24Plus;
const SAMPLES: u32 = 4;
/// Most handles that are marked.
const MARKS: usize = 256;
/// Radius of a handle's mark, in that of the scene.
const MARK: f64 = 0.013;
const BODY: [f32; 3] = [0.72, 0.66, 0.58];
const HANDLE: [f32; 3] = [0.85, 0.45, 0.15];
const CHOSEN: [f32; 3] = [0.90, 0.15, 0.25];

/// Triangles on the device.
struct Mesh {
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    count: u32,
}

impl Mesh {
    fn new(device: &wgpu::Device, triangles: &Triangles) -> Self {
        let usage = wgpu::BufferUsages::VERTEX;
        let buffer = |contents: &[u8], usage| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage })
        };
        Self {
            vertices: buffer(bytemuck::cast_slice(&triangles.vertices), usage),
            indices: buffer(bytemuck::cast_slice(&triangles.indices), wgpu::BufferUsages::INDEX),
            count: triangles.indices.len() as u32,
        }
    }
}

/// What is drawn on, and with.
pub struct View {
    surface: wgpu::Surface<'static>,
    shown: wgpu::SurfaceConfiguration,
    pipeline: wgpu::RenderPipeline,
    /// The picture before its samples are averaged, and its depth.
    samples: wgpu::TextureView,
    depth: wgpu::TextureView,
    looks: wgpu::Buffer,
    mark: Mesh,
}

/// The meshes of a session.
pub struct Meshes {
    cloth: wgpu::Buffer,
    cloth_count: u32,
    bodies: Vec<Mesh>,
}

impl Meshes {
    /// Returns the meshes of a session's scene; planes reach `radius` far \[m\].
    pub fn new(device: &wgpu::Device, scene: &fnopt::scene::Scene, session: &Session, radius: f64) -> Self {
        let setup = &session.setup;
        let cloth = &setup.model.cloths[0];
        let faces = cloth.faces(setup.model.grid);
        let indices = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            contents: bytemuck::cast_slice(&faces),
            usage: wgpu::BufferUsages::INDEX,
        });
        let of_scene = (setup.units.length_m, setup.up, radius);
        let bodies = scene.bodies.iter().zip(&cloth.bodies);
        let mesh = |(settings, body): (_, &fnopt::cloth::Body)| {
            Mesh::new(device, &triangles(settings, &body.shape, of_scene))
        };
        Self { cloth: indices, cloth_count: 3 * faces.len() as u32, bodies: bodies.map(mesh).collect() }
    }
}

impl View {
    /// Draws on this surface.
    pub fn new(
        device: &wgpu::Device,
        surface: wgpu::Surface<'static>,
        shown: wgpu::SurfaceConfiguration,
    ) -> Self {
        let targets = Targets { format: shown.format, depth: Some(DEPTH), samples: SAMPLES };
        let looks = device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: ((1 + MAX_BODIES + MARKS) * size_of::<Look>()) as u64,
            usage: wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let [samples, depth] = textures(device, &shown);
        let mark = Mesh::new(device, &capsule(1.0, 0.0));
        surface.configure(device, &shown);
        Self { surface, pipeline: pipeline(device, targets), shown, samples, depth, looks, mark }
    }

    /// Returns width and height of the canvas in pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.shown.width, self.shown.height]
    }

    /// Makes the canvas as large as this.
    pub fn resize(&mut self, device: &wgpu::Device, [width, height]: [u32; 2]) {
        (self.shown.width, self.shown.height) = (width, height);
        self.surface.configure(device, &self.shown);
        [self.samples, self.depth] = textures(device, &self.shown);
    }

    /// Returns what the next picture is drawn on; `None` if the canvas shows nothing now.
    pub fn target(&self) -> Option<wgpu::SurfaceTexture> {
        use wgpu::CurrentSurfaceTexture::{Suboptimal, Success};
        match self.surface.get_current_texture() {
            Success(target) | Suboptimal(target) => Some(target),
            _ => None,
        }
    }

    /// Records the picture of a session, whose handle `chosen` is marked as such.
    pub fn record(
        &self,
        (encoder, queue): (&mut wgpu::CommandEncoder, &wgpu::Queue),
        target: &wgpu::SurfaceTexture,
        (session, meshes): (&Session, &Meshes),
        (camera, chosen): (&Camera, Option<usize>),
    ) {
        let handles = session.handles().take(MARKS);
        let bodies: Vec<(usize, Pose)> = session.bodies().collect();
        let length = session.setup.units.length_m;
        let body = |(_, pose): &(usize, Pose)| {
            let turned = DQuat::from_array(pose.rotation);
            look(camera, DMat4::from_rotation_translation(turned, length * DVec3::from(pose.position)), BODY)
        };
        let mark = |(p, at): (usize, DVec3)| {
            let colour = if chosen == Some(p) { CHOSEN } else { HANDLE };
            let size = DVec3::splat(MARK * camera.radius());
            look(camera, DMat4::from_scale_rotation_translation(size, DQuat::IDENTITY, at), colour)
        };
        let mut looks = vec![look(camera, DMat4::IDENTITY, CLOTH)];
        looks.extend(bodies.iter().map(body));
        looks.extend(handles.map(mark));
        queue.write_buffer(&self.looks, 0, bytemuck::cast_slice(&looks));

        let view = target.texture.create_view(&Default::default());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &self.samples,
                depth_slice: None,
                resolve_target: Some(&view),
                // The page is seen where nothing is drawn.
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Discard,
                },
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
        pass.set_vertex_buffer(1, self.looks.slice(..));
        pass.set_vertex_buffer(0, session.vertices.tensor().buffer().slice(..));
        pass.set_index_buffer(meshes.cloth.slice(..), wgpu::IndexFormat::Uint32);
        pass.draw_indexed(0..meshes.cloth_count, 0, 0..1);
        let mut draw = |mesh: &Mesh, looks: std::ops::Range<u32>| {
            pass.set_vertex_buffer(0, mesh.vertices.slice(..));
            pass.set_index_buffer(mesh.indices.slice(..), wgpu::IndexFormat::Uint32);
            pass.draw_indexed(0..mesh.count, 0, looks);
        };
        for (at, (k, _)) in (1..).zip(&bodies) {
            draw(&meshes.bodies[*k], at..at + 1);
        }
        let marks = 1 + bodies.len() as u32..looks.len() as u32;
        if !marks.is_empty() {
            draw(&self.mark, marks);
        }
    }
}

/// Returns how a mesh is drawn that lies like this in space, lit from behind the eye.
fn look(camera: &Camera, place: DMat4, colour: [f32; 3]) -> Look {
    let [right, up] = camera.axes();
    let light = (camera.outward() + 0.5 * up - 0.3 * right).normalize();
    // Of a rotation, with or without a scale, the transpose takes directions back.
    let own = (DMat3::from_mat4(place).transpose() * light).normalize();
    let clip = (camera.clip() * place).as_mat4().to_cols_array_2d();
    Look { clip, light: own.as_vec3().to_array(), colour }
}

/// Returns the samples and the depth of a picture.
fn textures(device: &wgpu::Device, shown: &wgpu::SurfaceConfiguration) -> [wgpu::TextureView; 2] {
    [shown.format, DEPTH].map(|format| {
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width: shown.width, height: shown.height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: SAMPLES,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        texture.create_view(&Default::default())
    })
}
