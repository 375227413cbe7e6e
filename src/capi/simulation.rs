//! Simulations.

use super::check::{FnoptStatus, give, missing, room, slice, status, text, value};
use super::scene::FnoptScene;
use crate::bindings::Settings;
use crate::scene::{BodyPose, Scene};
use crate::{Error, Prescribed, Result, Simulation};
use std::ffi::c_char;
use std::path::PathBuf;

/// One cloth or a batch of cloths on one grid. Threads may use different simulations at the same time, but not the same one.
pub struct FnoptSimulation {
    simulation: Simulation,
}

/// What computes a simulation. Zeros and NULLs stand for the defaults.
#[repr(C)]
pub struct FnoptOptions {
    /// Name of the solver: "fnopt" (the default), "spectral", "newton", ..
    pub solver: *const c_char,
    /// "auto" (the default), "cpu" or "gpu".
    pub device: *const c_char,
    /// Part of the name of an adapter, or its index.
    pub adapter: *const c_char,
    /// A file of weights for the learned solvers.
    pub checkpoint: *const c_char,
    /// Iterations per frame.
    pub iterations: usize,
}

/// What to prescribe in a step. What is NULL is as in the scene.
#[repr(C)]
pub struct FnoptControl {
    /// Targets of the handles (m), x y z for each: all of cloth 0, then of cloth 1, and so on.
    pub handles: *const f64,
    /// Number of handles.
    pub handle_count: usize,
    /// Wind velocity (m/s), x y z for each cloth.
    pub wind: *const f64,
    /// Accelerations in addition to gravity and air (m/s^2), x y z for each particle of each cloth.
    pub accelerations: *const f64,
    /// Where the bodies are at the end of the frame, a position (m) and a quaternion (x y z w) for each: all of cloth 0, then of cloth 1,
    /// and so on. They move there from where the frame before left them, and what is attached to them goes along.
    pub bodies: *const f64,
    /// Number of bodies.
    pub body_count: usize,
}

/// What a cloth was like in a frame.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct FnoptStats {
    /// Energy at its end, in grid units.
    pub energy: f64,
    /// Norm of the energy's gradient in the first iteration.
    pub gradient_first: f64,
    /// Norm of the energy's gradient in the last iteration.
    pub gradient_last: f64,
    /// Largest stretch of an edge, as a share of its length.
    pub stretch_largest: f64,
    /// Mean stretch of an edge.
    pub stretch_mean: f64,
}

/// Makes a simulation of `cloths` scenes, one for each cloth; the same scene may be there several times. Their grids and frame
/// times are the same. `options` may be NULL. The scenes may be freed afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_simulation_new(
    scenes: *const Option<&FnoptScene>,
    cloths: usize,
    options: Option<&FnoptOptions>,
    simulation: *mut *mut FnoptSimulation,
) -> FnoptStatus {
    status(|| {
        // SAFETY: the caller's.
        let scenes = unsafe { slice(scenes, cloths) }.ok_or_else(|| missing("scenes"))?;
        let scenes: Option<Vec<&Scene>> = scenes.iter().map(|of| of.map(|of| &of.scene)).collect();
        let scenes = scenes.ok_or_else(|| missing("scenes"))?;
        let mut settings = Settings::default();
        if let Some(options) = options {
            // SAFETY: the caller's.
            let text = |argument, name: &str| unsafe { text(argument, name) };
            if let Some(solver) = text(options.solver, "solver")? {
                settings.solver = solver.into();
            }
            if let Some(device) = text(options.device, "device")? {
                settings.device = device.into();
            }
            settings.adapter = text(options.adapter, "adapter")?.map(Into::into);
            settings.checkpoint = text(options.checkpoint, "checkpoint")?.map(PathBuf::from);
            settings.iterations = (options.iterations > 0).then_some(options.iterations);
        }
        let make = || Ok(FnoptSimulation { simulation: settings.simulation(&scenes, 1)? });
        // SAFETY: the caller's.
        unsafe { give(make, simulation, "simulation") }
    })
}

/// Frees a simulation; NULL does nothing.
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_simulation_free(simulation: Option<Box<FnoptSimulation>>) {
    value((), || drop(simulation));
}

/// Computes the next frame as the scenes have it, events among it, but for what `control` prescribes, which may be NULL. After
/// the last frame, handles and bodies stay where they are. A step without bodies in its control leads them back to where the scenes
/// have them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_step(
    simulation: Option<&mut FnoptSimulation>,
    control: Option<&FnoptControl>,
) -> FnoptStatus {
    status(|| {
        let inner = &mut simulation.ok_or_else(none)?.simulation;
        let mut given = Prescribed::default();
        if let Some(control) = control {
            let cloths = inner.setups().len();
            // SAFETY: the caller's.
            let points = |argument, count| unsafe { points(argument, count) };
            given.handles = points(control.handles, control.handle_count);
            given.wind = points(control.wind, cloths);
            given.accelerations = points(control.accelerations, cloths * inner.particles());
            // SAFETY: the caller's.
            given.bodies = unsafe { poses(control.bodies, control.body_count) };
        }
        inner.step_with(&given).map(|_| ())
    })
}

/// Goes back to the start of the scenes.
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_reset(simulation: Option<&mut FnoptSimulation>) -> FnoptStatus {
    status(|| simulation.ok_or_else(none)?.simulation.reset())
}

/// Replaces the positions (m) and velocities (m/s) of one cloth, x y z for each particle. Velocities may be NULL for zeros. The
/// solver forgets what it remembers of the cloth; frames are counted on.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_set_state(
    simulation: Option<&mut FnoptSimulation>,
    cloth: usize,
    positions: *const f64,
    velocities: *const f64,
    count: usize,
) -> FnoptStatus {
    status(|| {
        let inner = &mut simulation.ok_or_else(none)?.simulation;
        let n = inner.particles();
        if count != 3 * n {
            return Err(Error::invalid("argument", "count", (3 * n).to_string(), count));
        }
        // SAFETY: the caller's.
        let [positions, velocities] = unsafe { [points(positions, n), points(velocities, n)] };
        let positions = positions.ok_or_else(|| missing("positions"))?;
        inner.set_cloth_state(cloth, &positions, &velocities.unwrap_or_else(|| vec![[0.0; 3]; n]))
    })
}

/// Writes the positions (m) of all cloths, x y z for each particle (i, j), which has number i W + j.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_positions(
    simulation: Option<&FnoptSimulation>,
    buffer: *mut f32,
    count: usize,
) -> FnoptStatus {
    // SAFETY: the caller's.
    status(|| unsafe { read(simulation, buffer, count, Simulation::write_positions) })
}

/// Writes the velocities (m/s) of all cloths likewise.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_velocities(
    simulation: Option<&FnoptSimulation>,
    buffer: *mut f32,
    count: usize,
) -> FnoptStatus {
    // SAFETY: the caller's.
    status(|| unsafe { read(simulation, buffer, count, Simulation::write_velocities) })
}

/// Writes the triangles of a cloth, three numbers of particles each, and returns how many there are. With NULL, it only does
/// the latter; room for fewer is filled as far as it goes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_faces(
    simulation: Option<&FnoptSimulation>,
    buffer: *mut u32,
    count: usize,
) -> usize {
    let faces = || simulation.map_or(Vec::new(), |of| of.simulation.faces());
    // SAFETY: the caller's.
    value(0, || unsafe { list(faces().as_flattened(), buffer, count) } / 3)
}

/// Writes where the bodies are at the end of the last frame, a position (m) and a quaternion (x y z w) each, all of cloth 0 first, and
/// returns how many bodies there are. With NULL, it only does the latter; room for fewer numbers is filled as far as it goes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_bodies(
    simulation: Option<&FnoptSimulation>,
    buffer: *mut f64,
    count: usize,
) -> usize {
    value(0, || {
        let bodies = simulation.map_or(Vec::new(), |of| of.simulation.bodies());
        let numbers: Vec<f64> = bodies.iter().flat_map(|&pose| <[f64; 7]>::from(pose)).collect();
        // SAFETY: the caller's.
        unsafe { list(&numbers, buffer, count) };
        bodies.len()
    })
}

/// Writes the numbers of the particles that are held now, within each cloth, all of cloth 0 first, and returns how many there
/// are. With NULL, it only does the latter; room for fewer is filled as far as it goes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_handles(
    simulation: Option<&FnoptSimulation>,
    buffer: *mut u32,
    count: usize,
) -> usize {
    value(0, || {
        let cloths = simulation.map_or(&[][..], |of| of.simulation.cloths());
        let held: Vec<u32> = cloths.iter().flat_map(|cloth| &cloth.handles).map(|&p| p as u32).collect();
        // SAFETY: the caller's.
        unsafe { list(&held, buffer, count) }
    })
}

/// Writes what each cloth was like in the last frame; zeros at the start.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_stats(
    simulation: Option<&FnoptSimulation>,
    stats: *mut FnoptStats,
    cloths: usize,
) -> FnoptStatus {
    status(|| {
        let inner = &simulation.ok_or_else(none)?.simulation;
        // SAFETY: the caller's.
        let room = unsafe { room(stats, cloths, inner.setups().len(), "stats") }?;
        room.fill(FnoptStats::default());
        for (to, of) in room.iter_mut().zip(&inner.frame().stats) {
            *to = FnoptStats {
                energy: of.energy.total(),
                gradient_first: of.gradient_first,
                gradient_last: of.gradient_last,
                stretch_largest: of.stretch_largest,
                stretch_mean: of.stretch_mean,
            };
        }
        Ok(())
    })
}

/// Returns the number of cloths; 0 for NULL, as the functions below.
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_cloths(simulation: Option<&FnoptSimulation>) -> usize {
    value(0, || simulation.map_or(0, |of| of.simulation.setups().len()))
}

/// Returns the number of particles of a cloth.
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_particles(simulation: Option<&FnoptSimulation>) -> usize {
    value(0, || simulation.map_or(0, |of| of.simulation.particles()))
}

/// Returns the number of the last frame; the start is 0.
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_frame(simulation: Option<&FnoptSimulation>) -> usize {
    value(0, || simulation.map_or(0, |of| of.simulation.frame().index))
}

/// Returns the number of frames of the longest scene, including the start.
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_frames(simulation: Option<&FnoptSimulation>) -> usize {
    value(0, || simulation.map_or(0, |of| of.simulation.frames()))
}

/// Returns the duration of a frame (s).
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_frame_time(simulation: Option<&FnoptSimulation>) -> f64 {
    value(0.0, || simulation.map_or(0.0, |of| of.simulation.setups()[0].units.frame_time_s))
}

fn none() -> Error {
    missing("simulation")
}

/// Writes what `write` says of all cloths.
unsafe fn read(
    simulation: Option<&FnoptSimulation>,
    buffer: *mut f32,
    count: usize,
    write: fn(&Simulation, &mut [f32]),
) -> Result<()> {
    let inner = &simulation.ok_or_else(none)?.simulation;
    let expected = 3 * inner.setups().len() * inner.particles();
    // SAFETY: the caller's.
    write(inner, unsafe { room(buffer, count, expected, "buffer") }?);
    Ok(())
}

/// Writes a list as far as there is room, and returns its length.
unsafe fn list<T: Copy>(list: &[T], buffer: *mut T, count: usize) -> usize {
    let count = count.min(list.len());
    // SAFETY: the caller's.
    if let Ok(room) = unsafe { room(buffer, count, count, "buffer") } {
        room.copy_from_slice(&list[..count]);
    }
    list.len()
}

/// Returns the poses of an argument, `None` for NULL.
unsafe fn poses(argument: *const f64, count: usize) -> Option<Vec<BodyPose>> {
    // SAFETY: the caller's.
    let rows = unsafe { slice(argument.cast::<[f64; 7]>(), count) };
    rows.map(|rows| rows.iter().map(|&row| row.into()).collect())
}

/// Returns the points of an argument, `None` for NULL.
unsafe fn points(argument: *const f64, count: usize) -> Option<Vec<[f64; 3]>> {
    // SAFETY: the caller's.
    let points = unsafe { slice(argument.cast::<[f64; 3]>(), count) };
    points.map(<[_]>::to_vec)
}
