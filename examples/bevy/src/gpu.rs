//! Cloths in Bevy's render world: fnopt records its frames into Bevy's commands, and Bevy's passes draw the vertex buffer
//! that it writes, with Bevy's materials, lights and shadows. Nothing is copied.

use crate::cloth::Running;
use bevy::core_pipeline::core_3d::Opaque3d;
use bevy::core_pipeline::prepass::Opaque3dPrepass;
use bevy::core_pipeline::schedule::camera_driver;
use bevy::ecs::query::ROQueryItem;
use bevy::ecs::system::lifetimeless::SRes;
use bevy::ecs::system::{ReadOnlySystemParam, SystemParamItem};
use bevy::pbr::{
    DrawDepthOnlyPrepass, DrawMaterial, DrawMesh, DrawPrepass, MATERIAL_BIND_GROUP_INDEX,
    SetMaterialBindGroup, SetMeshBindGroup, SetMeshViewBindGroup, SetMeshViewBindingArrayBindGroup,
    SetPrepassEmptyMaterialBindGroup, SetPrepassViewBindGroup, SetPrepassViewEmptyBindGroup, Shadow,
};
use bevy::prelude::*;
use bevy::render::mesh::RenderMeshBufferInfo;
use bevy::render::render_phase::{
    DrawFunctions, PhaseItem, RenderCommand, RenderCommandResult, RenderCommandState, SetItemPipeline,
    TrackedRenderPass,
};
use bevy::render::render_resource::Buffer;
use bevy::render::renderer::{RenderContext, RenderDevice, RenderGraph, RenderGraphSystems, RenderQueue};
use bevy::render::sync_world::{MainEntity, MainEntityHashMap};
use bevy::render::{ExtractSchedule, MainWorld, Render, RenderApp, RenderSystems};
use fnopt::cloth::Control;
use fnopt::gpu::Context;
use fnopt::scene::Setup;
use fnopt::sim::{Optimizer, Solver, Vertices};
use std::sync::Arc;

/// Adds the systems of the render world, and draws meshes that are cloths from their own buffers.
pub fn build(app: &mut App) {
    let Some(render) = app.get_sub_app_mut(RenderApp) else { return };
    render
        .init_resource::<Cloths>()
        .add_systems(ExtractSchedule, extract)
        .add_systems(Render, prepare.in_set(RenderSystems::PrepareResources))
        .add_systems(RenderGraph, record.in_set(RenderGraphSystems::Render).before(camera_driver));
    let world = render.world_mut();
    replace::<Opaque3d, DrawMaterial, DrawMaterialOrCloth>(world);
    replace::<Opaque3dPrepass, DrawPrepass, DrawPrepassOrCloth>(world);
    replace::<Opaque3dPrepass, DrawDepthOnlyPrepass, DrawDepthOrCloth>(world);
    replace::<Shadow, DrawPrepass, DrawPrepassOrCloth>(world);
    replace::<Shadow, DrawDepthOnlyPrepass, DrawDepthOrCloth>(world);
}

/// Lets materials that ask a phase for the command `Known` get `New`.
fn replace<P: PhaseItem, Known: 'static, New>(world: &mut World)
where
    New: RenderCommand<P> + Send + Sync + 'static,
    New::Param: ReadOnlySystemParam,
{
    let command = RenderCommandState::<P, New>::new(world);
    world.resource::<DrawFunctions<P>>().write().add_with::<Known, _>(command);
}

/// The cloths on the device.
#[derive(Resource, Default)]
pub struct Cloths {
    context: Option<Context>,
    known: MainEntityHashMap<OnDevice>,
    /// Time between the frame before and the current one, 0 to 1.
    time: f32,
}

/// A cloth, with the controls of the frames that wait.
struct OnDevice {
    setup: Arc<Setup>,
    optimizer: Optimizer,
    iterations: usize,
    controls: Vec<Control<f32>>,
    is_there: bool,
    /// `None` before it is built, and if that failed.
    built: Option<Built>,
    has_failed: bool,
}

struct Built {
    solver: Solver,
    vertices: Vertices,
    buffer: Buffer,
}

/// Takes the controls of new frames from the main world.
fn extract(mut main: ResMut<MainWorld>, mut cloths: ResMut<Cloths>) {
    cloths.time = main.resource::<Time<Fixed>>().overstep_fraction();
    cloths.known.values_mut().for_each(|cloth| cloth.is_there = false);
    let mut running = main.query::<(Entity, &mut Running)>();
    for (entity, mut cloth) in running.iter_mut(&mut main) {
        let controls = std::mem::take(&mut cloth.controls);
        let known = cloths.known.entry(MainEntity::from(entity)).or_insert_with(|| OnDevice {
            setup: cloth.setup.clone(),
            optimizer: cloth.optimizer.clone(),
            iterations: cloth.iterations,
            controls: Vec::new(),
            is_there: true,
            built: None,
            has_failed: false,
        });
        known.is_there = true;
        known.controls.extend(controls);
    }
    cloths.known.retain(|_, cloth| cloth.is_there);
}

/// Builds solvers of new cloths on Bevy's device.
fn prepare(mut cloths: ResMut<Cloths>, device: Res<RenderDevice>, queue: Res<RenderQueue>) {
    let Cloths { context, known, .. } = &mut *cloths;
    for cloth in known.values_mut().filter(|cloth| cloth.built.is_none() && !cloth.has_failed) {
        let built = match context {
            Some(context) => Built::new(context, cloth),
            None => Context::new(device.wgpu_device().clone(), (**queue).clone())
                .and_then(|new| Built::new(context.insert(new), cloth)),
        };
        match built {
            Ok(built) => cloth.built = Some(built),
            Err(problem) => {
                error!("{problem}");
                cloth.has_failed = true;
            }
        }
    }
}

impl Built {
    fn new(context: &Context, cloth: &OnDevice) -> fnopt::Result<Self> {
        let setup = &cloth.setup;
        let solver = Solver::new(context, &setup.model, &cloth.optimizer, cloth.iterations)?;
        solver.set_state(&setup.start.cast());
        let vertices = match &setup.embedding {
            Some(mesh) => solver.embedded_vertices(&mesh.embedding)?,
            None => solver.vertices()?,
        };
        vertices.set_view(&setup.vertex_view());
        // A handle of the same buffer.
        let buffer = Buffer::from(vertices.tensor().buffer().clone());
        Ok(Self { solver, vertices, buffer })
    }
}

/// Records the frames that wait, and the vertices at the time that is drawn, before the passes of the cameras.
fn record(mut commands: RenderContext, mut cloths: ResMut<Cloths>) {
    let Cloths { known, time, .. } = &mut *cloths;
    for cloth in known.values_mut() {
        let Some(Built { solver, vertices, .. }) = &cloth.built else { continue };
        let controls = std::mem::take(&mut cloth.controls);
        if let Err(problem) = solver.record_frames(commands.command_encoder(), &controls) {
            error!("{problem}");
        }
        vertices.set_time(*time);
        vertices.record(commands.command_encoder());
    }
}

type DrawMaterialOrCloth = (
    SetItemPipeline,
    SetMeshViewBindGroup<0>,
    SetMeshViewBindingArrayBindGroup<1>,
    SetMeshBindGroup<2>,
    SetMaterialBindGroup<MATERIAL_BIND_GROUP_INDEX>,
    DrawMeshOrCloth,
);
type DrawPrepassOrCloth = (
    SetItemPipeline,
    SetPrepassViewBindGroup<0>,
    SetPrepassViewEmptyBindGroup<1>,
    SetMeshBindGroup<2>,
    SetMaterialBindGroup<MATERIAL_BIND_GROUP_INDEX>,
    DrawMeshOrCloth,
);
type DrawDepthOrCloth = (
    SetItemPipeline,
    SetPrepassViewBindGroup<0>,
    SetPrepassViewEmptyBindGroup<1>,
    SetMeshBindGroup<2>,
    SetPrepassEmptyMaterialBindGroup<MATERIAL_BIND_GROUP_INDEX>,
    DrawMeshOrCloth,
);

/// Draws what [`DrawMesh`] draws, but cloths from fnopt's vertex buffer: position and normal, as their meshes have them.
pub struct DrawMeshOrCloth;

impl<P: PhaseItem> RenderCommand<P> for DrawMeshOrCloth {
    type Param = (SRes<Cloths>, <DrawMesh as RenderCommand<P>>::Param);
    type ViewQuery = <DrawMesh as RenderCommand<P>>::ViewQuery;
    type ItemQuery = ();

    fn render<'w>(
        item: &P,
        view: ROQueryItem<'w, '_, Self::ViewQuery>,
        entity: Option<()>,
        (cloths, of_mesh): SystemParamItem<'w, '_, Self::Param>,
        pass: &mut TrackedRenderPass<'w>,
    ) -> RenderCommandResult {
        let Some(cloth) = cloths.into_inner().known.get(&item.main_entity()) else {
            return <DrawMesh as RenderCommand<P>>::render(item, view, entity, of_mesh, pass);
        };
        let (meshes, instances, _, _, allocator, preprocessing, _) = of_mesh;
        // Where the instance is, compute shaders of Bevy say.
        let is_placed = preprocessing.is_none() || view;
        let mesh = instances.into_inner().mesh_asset_id(item.main_entity());
        let found = mesh.and_then(|id| {
            let RenderMeshBufferInfo::Indexed { index_format, count } =
                meshes.into_inner().get(id)?.buffer_info
            else {
                return None;
            };
            Some((allocator.into_inner().mesh_index_slice(&id)?, index_format, count))
        });
        let (Some(built), Some((indices, format, count)), true) = (&cloth.built, found, is_placed) else {
            return RenderCommandResult::Skip;
        };
        pass.set_vertex_buffer(0, built.buffer.slice(..));
        pass.set_index_buffer(indices.buffer.slice(..), format);
        pass.draw_indexed(indices.range.start..indices.range.start + count, 0, item.batch_range().clone());
        RenderCommandResult::Success
    }
}
