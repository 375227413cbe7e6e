//! A cloth inside an engine. The engine (`host/mod.rs`) owns the device, queue, encoder and pipeline. fnopt
//! records its frame into that encoder, and the sheet is drawn from a vertex buffer that never leaves the
//! device, without copies or waiting.

mod host;

use fnopt::gpu::Context;
use fnopt::{Optimizer, Scene, Solver, Weights, wgpu};
use host::Host;

const FRAMES: usize = 30;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let host = Host::open()?;

    // The cloth on the host's device.
    let context = Context::new(host.device.clone(), host.queue.clone())?;
    let setup = Scene::default().setup()?;
    let optimizer = Optimizer::learned(Weights::shipped());
    let solver = Solver::new(&context, &setup.model, &optimizer, 10)?;
    solver.set_state(&setup.start.cast());

    // Positions and normals in one vertex buffer, in metres along the scene's axes, y up.
    let vertices = solver.vertices()?;
    vertices.set_view(&setup.vertex_view());
    let (grid, handle) = (setup.model.grid, setup.model.cloths[0].handles[0]);
    let faces = grid.faces().concat();
    let indices = host.index_buffer(&faces);

    let mut control = setup.control::<f32>(0);
    for _ in 0..FRAMES {
        control.handles[0][2] += 0.1; // a tenth of an edge upwards
        solver.set_control(&control);

        let mut encoder = host.device.create_command_encoder(&Default::default());
        solver.record(&mut encoder);
        vertices.record(&mut encoder);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[Some(host.attachment())],
            ..Default::default()
        });
        pass.set_pipeline(&host.pipeline);
        pass.set_vertex_buffer(0, vertices.tensor().buffer().slice(..));
        pass.set_vertex_buffer(1, host.look.slice(..));
        pass.set_index_buffer(indices.slice(..), wgpu::IndexFormat::Uint32);
        pass.draw_indexed(0..faces.len() as u32, 0, 0..1);
        drop(pass);
        host.queue.submit([encoder.finish()]);
    }

    let x: Vec<f32> = solver.positions().read(&context)?;
    let at = [0, 1, 2].map(|axis| x[axis * grid.particles() + handle]);
    let drawn = host.pixels(&context)?.iter().filter(|&&pixel| pixel != 0).count();
    println!("{FRAMES} frames on {}: handle at {at:.2?} edges, {drawn} pixels drawn", context.name());
    assert!(x.iter().all(|v| v.is_finite()), "every particle is somewhere");
    assert!(at.iter().zip(control.handles[0]).all(|(a, b)| (a - b).abs() < 1e-4), "{:?}", control.handles[0]);
    assert!((4_000..20_000).contains(&drawn), "the sheet covers a part of the picture, {drawn} pixels");
    Ok(())
}
