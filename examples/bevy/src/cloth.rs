//! Cloths as entities: what an application spawns and moves.

use crate::gpu;
use bevy::asset::RenderAssetUsages;
use bevy::camera::visibility::NoFrustumCulling;
use bevy::mesh::{Indices, PrimitiveTopology};
use bevy::prelude::*;
use bevy::render::batching::NoAutomaticBatching;
use fnopt::cloth::Control;
use fnopt::io::vertex_normals;
use fnopt::scene::{Scene, Setup};
use fnopt::sim::Optimizer;
use std::sync::Arc;

/// Simulates and draws every entity with a [`Cloth`]. Comes after the default plugins. The cameras need
/// [`NoIndirectDrawing`](bevy::render::view::NoIndirectDrawing), since cloths are drawn directly.
pub struct ClothPlugin;

impl Plugin for ClothPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(PreUpdate, begin).add_systems(FixedPostUpdate, step);
        gpu::build(app);
    }
}

/// A cloth, in the axes and metres of its entity's transform. Its material is the entity's, an opaque
/// [`StandardMaterial`] without textures: a vertex is a position and a normal.
#[derive(Component, Clone)]
#[require(Transform, Visibility, NoFrustumCulling, NoAutomaticBatching)]
pub struct Cloth {
    /// Grid, fabric, handles and bodies. A frame of it is a step of the fixed schedule, which has to take as long.
    pub scene: Scene,
    /// The solver.
    pub optimizer: Optimizer,
    /// Its iterations in a frame.
    pub iterations: usize,
}

/// Where the handles of a cloth are to be \[m\], in the cloth's own axes; at first where they are.
#[derive(Component, Deref, DerefMut)]
pub struct Handles(pub Vec<Vec3>);

/// A cloth that has begun.
#[derive(Component)]
pub struct Running {
    pub setup: Arc<Setup>,
    pub optimizer: Optimizer,
    pub iterations: usize,
    /// Controls of the frames that the device has not been given.
    pub controls: Vec<Control<f32>>,
    frame: usize,
}

/// Prepares new cloths: their triangles as a mesh, whose vertices the device replaces.
fn begin(
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    new: Query<(Entity, &Cloth), Added<Cloth>>,
) {
    for (entity, cloth) in &new {
        let setup = match cloth.scene.setup() {
            Ok(setup) => setup,
            Err(problem) => {
                error!("{problem}");
                continue;
            }
        };
        let start = setup.start.cast();
        let ([points, _], [particles, _]) = (setup.points(&start), setup.particles(&start));
        let triangles: Vec<[u32; 3]> = setup.topology().triangles().collect();
        let normals = vertex_normals(&points, &triangles);
        let mesh = Mesh::new(PrimitiveTopology::TriangleList, RenderAssetUsages::RENDER_WORLD)
            .with_inserted_attribute(Mesh::ATTRIBUTE_POSITION, points)
            .with_inserted_attribute(Mesh::ATTRIBUTE_NORMAL, normals)
            .with_inserted_indices(Indices::U32(triangles.concat()));
        let handles = &setup.model.cloths[0].handles;
        let handles = Handles(handles.iter().map(|&p| Vec3::from(particles[p])).collect());
        let Cloth { optimizer, iterations, .. } = cloth.clone();
        let running =
            Running { setup: Arc::new(setup), optimizer, iterations, controls: Vec::new(), frame: 0 };
        commands.entity(entity).insert((Mesh3d(meshes.add(mesh)), handles, running));
    }
}

/// Adds a frame: what the scene says of it, with the handles where they are to be.
fn step(mut cloths: Query<(&mut Running, &Handles)>) {
    for (mut cloth, handles) in &mut cloths {
        cloth.frame += 1;
        let mut control: Control<f32> = cloth.setup.control(cloth.frame);
        for (target, handle) in control.handles.iter_mut().zip(&handles.0) {
            *target = cloth.setup.handle_at(handle.to_array().map(f64::from));
        }
        cloth.controls.push(control);
    }
}
