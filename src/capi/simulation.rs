//! Simulations.

use super::FnoptStatus;
use super::check::{missing, room, slice, status, text, value};
use super::scene::FnoptScene;
use crate::bindings::{Control, Session, Settings};
use crate::scene::Scene;
use crate::{Error, Result};
use std::ffi::c_char;
use std::path::PathBuf;

/// One cloth or a batch of cloths on one grid. Threads may use different simulations at the same time, but not the same one.
pub struct FnoptSimulation {
    session: Session,
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
///
/// # Safety
///
/// `scenes` points to `cloths` scenes of this library; the texts in `options` end with a zero or are NULL; `simulation`
/// points to room for a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_simulation_new(
    scenes: *const *const FnoptScene,
    cloths: usize,
    options: *const FnoptOptions,
    simulation: *mut *mut FnoptSimulation,
) -> FnoptStatus {
    status(|| {
        // SAFETY: as above.
        let scenes = unsafe { slice(scenes, cloths) }.ok_or_else(|| missing("scenes"))?;
        // SAFETY: as above.
        let scene = |scene: &*const FnoptScene| unsafe { scene.as_ref() }.map(|scene| &scene.scene);
        let scenes: Vec<&Scene> =
            scenes.iter().map(scene).collect::<Option<_>>().ok_or_else(|| missing("scenes"))?;
        let mut settings = Settings::default();
        // SAFETY: as above.
        if let Some(options) = unsafe { options.as_ref() } {
            // SAFETY: as above.
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
        if simulation.is_null() {
            return Err(missing("simulation"));
        }
        let session = Session::new(&scenes, 1, &settings)?;
        // SAFETY: as above.
        unsafe { simulation.write(Box::into_raw(Box::new(FnoptSimulation { session }))) };
        Ok(())
    })
}

/// Frees a simulation; NULL does nothing.
///
/// # Safety
///
/// `simulation` is NULL or a simulation of this library that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_simulation_free(simulation: *mut FnoptSimulation) {
    value((), || {
        if !simulation.is_null() {
            // SAFETY: `fnopt_simulation_new` made it from a box.
            drop(unsafe { Box::from_raw(simulation) });
        }
    });
}

/// Computes the next frame as the scenes have it, events among it, but for what `control` prescribes, which may be NULL. After
/// the last frame, handles and bodies stay where they are.
///
/// # Safety
///
/// `simulation` is one of this library; what is not NULL in `control` has as many numbers as it says there.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_step(
    simulation: *mut FnoptSimulation,
    control: *const FnoptControl,
) -> FnoptStatus {
    status(|| {
        // SAFETY: as above.
        let session = unsafe { session(simulation) }?;
        let mut given = Control::default();
        // SAFETY: as above.
        if let Some(control) = unsafe { control.as_ref() } {
            let cloths = session.setups().len();
            // SAFETY: as above.
            given.handles = unsafe { points(control.handles, control.handle_count) };
            // SAFETY: as above.
            given.wind = unsafe { points(control.wind, cloths) };
            // SAFETY: as above.
            given.accelerations = unsafe { points(control.accelerations, cloths * session.particles()) };
        }
        session.step(&given)
    })
}

/// Goes back to the start of the scenes.
///
/// # Safety
///
/// `simulation` is one of this library.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_reset(simulation: *mut FnoptSimulation) -> FnoptStatus {
    // SAFETY: as above.
    status(|| unsafe { session(simulation) }?.reset())
}

/// Replaces the positions (m) and velocities (m/s) of one cloth, x y z for each particle. Velocities may be NULL for zeros. The
/// solver forgets what it remembers of the cloth; frames are counted on.
///
/// # Safety
///
/// `simulation` is one of this library; `positions` and, unless NULL, `velocities` point to `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_set_state(
    simulation: *mut FnoptSimulation,
    cloth: usize,
    positions: *const f64,
    velocities: *const f64,
    count: usize,
) -> FnoptStatus {
    status(|| {
        // SAFETY: as above.
        let session = unsafe { session(simulation) }?;
        let expected = 3 * session.particles();
        if count != expected {
            return Err(Error::invalid("argument", "count", expected.to_string(), count));
        }
        // SAFETY: as above.
        let positions = unsafe { points(positions, count / 3) }.ok_or_else(|| missing("positions"))?;
        // SAFETY: as above.
        let velocities = unsafe { points(velocities, count / 3) };
        let velocities = velocities.unwrap_or_else(|| vec![[0.0; 3]; positions.len()]);
        session.set_cloth_state(cloth, &positions, &velocities)
    })
}

/// Writes the positions (m) of all cloths, x y z for each particle (i, j), which has number i W + j.
///
/// # Safety
///
/// `simulation` is one of this library; `buffer` points to room for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_positions(
    simulation: *const FnoptSimulation,
    buffer: *mut f32,
    count: usize,
) -> FnoptStatus {
    status(|| {
        // SAFETY: as above.
        let session = unsafe { read(simulation) }?;
        // SAFETY: as above.
        session.positions(unsafe { room(buffer, count, 3 * all_particles(session), "buffer") }?);
        Ok(())
    })
}

/// Writes the velocities (m/s) of all cloths likewise.
///
/// # Safety
///
/// `simulation` is one of this library; `buffer` points to room for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_velocities(
    simulation: *const FnoptSimulation,
    buffer: *mut f32,
    count: usize,
) -> FnoptStatus {
    status(|| {
        // SAFETY: as above.
        let session = unsafe { read(simulation) }?;
        // SAFETY: as above.
        session.velocities(unsafe { room(buffer, count, 3 * all_particles(session), "buffer") }?);
        Ok(())
    })
}

/// Writes the triangles of a cloth, three numbers of particles each, and returns how many there are. With NULL, it only does
/// the latter; room for fewer is filled as far as it goes.
///
/// # Safety
///
/// `simulation` is one of this library; `buffer` is NULL or points to room for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_faces(
    simulation: *const FnoptSimulation,
    buffer: *mut u32,
    count: usize,
) -> usize {
    value(0, || {
        // SAFETY: as above.
        let Ok(session) = (unsafe { read(simulation) }) else { return 0 };
        let faces = session.setups()[0].model.grid.faces();
        if !buffer.is_null() {
            // SAFETY: as above.
            let buffer = unsafe { std::slice::from_raw_parts_mut(buffer, count) };
            buffer.iter_mut().zip(faces.as_flattened()).for_each(|(to, &from)| *to = from);
        }
        faces.len()
    })
}

/// Writes the numbers of the particles that are held now, within each cloth, all of cloth 0 first, and returns how many there
/// are. With NULL, it only does the latter; room for fewer is filled as far as it goes.
///
/// # Safety
///
/// `simulation` is one of this library; `buffer` is NULL or points to room for `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_handles(
    simulation: *const FnoptSimulation,
    buffer: *mut u32,
    count: usize,
) -> usize {
    value(0, || {
        // SAFETY: as above.
        let Ok(session) = (unsafe { read(simulation) }) else { return 0 };
        let held = session.cloths().iter().flat_map(|cloth| &cloth.handles);
        if !buffer.is_null() {
            // SAFETY: as above.
            let buffer = unsafe { std::slice::from_raw_parts_mut(buffer, count) };
            buffer.iter_mut().zip(held.clone()).for_each(|(to, &from)| *to = from as u32);
        }
        held.count()
    })
}

/// Writes what each cloth was like in the last frame; zeros at the start.
///
/// # Safety
///
/// `simulation` is one of this library; `stats` points to room for `cloths` of them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_stats(
    simulation: *const FnoptSimulation,
    stats: *mut FnoptStats,
    cloths: usize,
) -> FnoptStatus {
    status(|| {
        // SAFETY: as above.
        let session = unsafe { read(simulation) }?;
        // SAFETY: as above.
        let room = unsafe { room(stats, cloths, session.setups().len(), "stats") }?;
        room.fill(FnoptStats::default());
        for (to, of) in room.iter_mut().zip(&session.frame().stats) {
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
///
/// # Safety
///
/// `simulation` is NULL or one of this library.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_cloths(simulation: *const FnoptSimulation) -> usize {
    // SAFETY: as above.
    unsafe { number(simulation, |session| session.setups().len()) }
}

/// Returns the number of particles of a cloth.
///
/// # Safety
///
/// `simulation` is NULL or one of this library.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_particles(simulation: *const FnoptSimulation) -> usize {
    // SAFETY: as above.
    unsafe { number(simulation, Session::particles) }
}

/// Returns the number of the last frame; the start is 0.
///
/// # Safety
///
/// `simulation` is NULL or one of this library.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_frame(simulation: *const FnoptSimulation) -> usize {
    // SAFETY: as above.
    unsafe { number(simulation, |session| session.frame().index) }
}

/// Returns the number of frames of the longest scene, including the start.
///
/// # Safety
///
/// `simulation` is NULL or one of this library.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_frames(simulation: *const FnoptSimulation) -> usize {
    // SAFETY: as above.
    unsafe { number(simulation, Session::frames) }
}

/// Returns the duration of a frame (s).
///
/// # Safety
///
/// `simulation` is NULL or one of this library.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_frame_time(simulation: *const FnoptSimulation) -> f64 {
    // SAFETY: as above.
    value(0.0, || unsafe { read(simulation) }.map_or(0.0, |of| of.setups()[0].units.frame_time_s))
}

unsafe fn number(simulation: *const FnoptSimulation, of: impl FnOnce(&Session) -> usize) -> usize {
    // SAFETY: the caller's.
    value(0, || unsafe { read(simulation) }.map_or(0, of))
}

unsafe fn session<'a>(simulation: *mut FnoptSimulation) -> Result<&'a mut Session> {
    // SAFETY: the caller's.
    unsafe { simulation.as_mut() }.map(|of| &mut of.session).ok_or_else(|| missing("simulation"))
}

unsafe fn read<'a>(simulation: *const FnoptSimulation) -> Result<&'a Session> {
    // SAFETY: the caller's.
    unsafe { simulation.as_ref() }.map(|of| &of.session).ok_or_else(|| missing("simulation"))
}

/// Returns the points of an argument, `None` for NULL.
unsafe fn points(argument: *const f64, count: usize) -> Option<Vec<[f64; 3]>> {
    // SAFETY: the caller's.
    let numbers = unsafe { slice(argument, count * 3) }?;
    Some(numbers.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect())
}

fn all_particles(session: &Session) -> usize {
    session.setups().len() * session.particles()
}
