/* Cloth in SI units, along the axes of each scene: lengths in metres, times in seconds (docs/c.md).
 *
 * Build the library with
 *     cargo rustc --release --lib --no-default-features --features capi --crate-type cdylib
 */

#ifndef FNOPT_H
#define FNOPT_H

/* Made from src/capi by cbindgen; do not edit. */

#include <stddef.h>
#include <stdint.h>

/// How a call ended: the exit codes of the command.
typedef enum {
  /// Done.
  FNOPT_STATUS_DONE = 0,
  /// Bad input or environment: an argument, a file, a device.
  FNOPT_STATUS_BAD_INPUT = 2,
  /// The simulation became non-finite; its state can still be read and replaced.
  FNOPT_STATUS_NON_FINITE = 3,
} FnoptStatus;

/// A cloth, the forces on it and the motion of its handles.
typedef struct FnoptScene FnoptScene;

/// One cloth or a batch of cloths on one grid. Threads may use different simulations at the same time, but not the same one.
typedef struct FnoptSimulation FnoptSimulation;

/// What computes a simulation. Zeros and NULLs stand for the defaults.
typedef struct {
  /// Name of the solver: "fnopt" (the default), "spectral", "newton", ..
  const char *solver;
  /// "auto" (the default), "cpu" or "gpu".
  const char *device;
  /// Part of the name of an adapter, or its index.
  const char *adapter;
  /// A file of weights for the learned solvers.
  const char *checkpoint;
  /// Iterations per frame.
  size_t iterations;
} FnoptOptions;

/// What to prescribe in a step. What is NULL is as in the scene.
typedef struct {
  /// Targets of the handles (m), x y z for each: all of cloth 0, then of cloth 1, and so on.
  const double *handles;
  /// Number of handles.
  size_t handle_count;
  /// Wind velocity (m/s), x y z for each cloth.
  const double *wind;
  /// Accelerations in addition to gravity and air (m/s^2), x y z for each particle of each cloth.
  const double *accelerations;
  /// Where the bodies are at the end of the frame, a position (m) and a quaternion (x y z w) for each: all of cloth 0, then of cloth 1,
  /// and so on. They move there from where the frame before left them, and what is attached to them goes along.
  const double *bodies;
  /// Number of bodies.
  size_t body_count;
} FnoptControl;

/// What a cloth was like in a frame.
typedef struct {
  /// Energy at its end, in grid units.
  double energy;
  /// Norm of the energy's gradient in the first iteration.
  double gradient_first;
  /// Norm of the energy's gradient in the last iteration.
  double gradient_last;
  /// Largest stretch of an edge, as a share of its length.
  double stretch_largest;
  /// Mean stretch of an edge.
  double stretch_mean;
} FnoptStats;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/// Returns what was wrong with the last call on this thread that did not return FNOPT_STATUS_DONE, in UTF-8; an empty text if there
/// was none. It is valid until the next such call on this thread.
const char *fnopt_last_error(void);

/// Returns the version of the library.
const char *fnopt_version(void);

/// Makes the default scene: a sheet of 1 m that hangs from two corners, which move.
FnoptStatus fnopt_scene_default(FnoptScene **scene);

/// Reads a scene file (JSON), or makes the scene of this name that comes with the library.
FnoptStatus fnopt_scene_load(const char *path, FnoptScene **scene);

/// Parses the text of a scene file. Relative paths in it are those of `folder`, or of the current folder if it is NULL.
FnoptStatus fnopt_scene_parse(const char *json,
                              const char *folder,
                              FnoptScene **scene);

/// Moves a scene to another grid, of 8 to 4096 particles along the height and the width, with its handles and its start.
FnoptStatus fnopt_scene_set_grid(FnoptScene *scene,
                                 size_t height,
                                 size_t width);

/// Sets the number of frames of a scene, including the start. Fewer than it has are a part of it.
FnoptStatus fnopt_scene_set_frames(FnoptScene *scene, size_t frames);

/// Frees a scene, which simulations of it do not need; NULL does nothing.
void fnopt_scene_free(FnoptScene *scene);

/// Makes a simulation of `cloths` scenes, one for each cloth; the same scene may be there several times. Their grids and frame
/// times are the same. `options` may be NULL. The scenes may be freed afterwards.
FnoptStatus fnopt_simulation_new(const FnoptScene *const *scenes,
                                 size_t cloths,
                                 const FnoptOptions *options,
                                 FnoptSimulation **simulation);

/// Frees a simulation; NULL does nothing.
void fnopt_simulation_free(FnoptSimulation *simulation);

/// Computes the next frame as the scenes have it, events among it, but for what `control` prescribes, which may be NULL. After
/// the last frame, handles and bodies stay where they are. A step without bodies in its control leads them back to where the scenes
/// have them.
FnoptStatus fnopt_step(FnoptSimulation *simulation,
                       const FnoptControl *control);

/// Goes back to the start of the scenes.
FnoptStatus fnopt_reset(FnoptSimulation *simulation);

/// Replaces the positions (m) and velocities (m/s) of one cloth, x y z for each particle. Velocities may be NULL for zeros. The
/// solver forgets what it remembers of the cloth; frames are counted on.
FnoptStatus fnopt_set_state(FnoptSimulation *simulation,
                            size_t cloth,
                            const double *positions,
                            const double *velocities,
                            size_t count);

/// Writes the positions (m) of all cloths, x y z for each particle (i, j), which has number i W + j.
FnoptStatus fnopt_positions(const FnoptSimulation *simulation, float *buffer, size_t count);

/// Writes the velocities (m/s) of all cloths likewise.
FnoptStatus fnopt_velocities(const FnoptSimulation *simulation, float *buffer, size_t count);

/// Writes the triangles of a cloth, three numbers of particles each, and returns how many there are. With NULL, it only does
/// the latter; room for fewer is filled as far as it goes.
size_t fnopt_faces(const FnoptSimulation *simulation,
                   uint32_t *buffer,
                   size_t count);

/// Writes where the bodies are at the end of the last frame, a position (m) and a quaternion (x y z w) each, all of cloth 0 first, and
/// returns how many bodies there are. With NULL, it only does the latter; room for fewer numbers is filled as far as it goes.
size_t fnopt_bodies(const FnoptSimulation *simulation, double *buffer, size_t count);

/// Writes the numbers of the particles that are held now, within each cloth, all of cloth 0 first, and returns how many there
/// are. With NULL, it only does the latter; room for fewer is filled as far as it goes.
size_t fnopt_handles(const FnoptSimulation *simulation,
                     uint32_t *buffer,
                     size_t count);

/// Writes what each cloth was like in the last frame; zeros at the start.
FnoptStatus fnopt_stats(const FnoptSimulation *simulation, FnoptStats *stats, size_t cloths);

/// Returns the number of cloths; 0 for NULL, as the functions below.
size_t fnopt_cloths(const FnoptSimulation *simulation);

/// Returns the number of particles of a cloth.
size_t fnopt_particles(const FnoptSimulation *simulation);

/// Returns the number of the last frame; the start is 0.
size_t fnopt_frame(const FnoptSimulation *simulation);

/// Returns the number of frames of the longest scene, including the start.
size_t fnopt_frames(const FnoptSimulation *simulation);

/// Returns the duration of a frame (s).
double fnopt_frame_time(const FnoptSimulation *simulation);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* FNOPT_H */
