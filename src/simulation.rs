//! A simulation that owns its scenes and goes through them frame by frame, in SI units.

use crate::cloth::{Cloth, Pose, State, Sweep};
use crate::device::{Device, DeviceChoice, store_pipelines};
use crate::io::Recording;
use crate::scene::{BodyPose, Course, Scene, Script, Scripts, Setup};
use crate::sim::{Memory, Optimizer};
use crate::{Error, Frame, Result, Simulator, cloth};
use rayon::prelude::*;
use std::path::Path;

/// A batch of cloths that advances through its scenes, in metres, seconds and the axes of each scene.
///
/// ```
/// use fnopt::{Optimizer, Scene, Simulation};
///
/// let mut scene = Scene::named("sphere")?; // a sheet that falls on a ball
/// scene.regrid(fnopt::cloth::Grid { h: 16, w: 16 })?;
/// let mut simulation = Simulation::new(&scene, &Optimizer::spectral())?;
/// while simulation.frame().index < 30 {
///     simulation.step()?;
/// }
/// let lowest = simulation.positions().iter().map(|p| p[1]).fold(f32::INFINITY, f32::min);
/// println!("frame 30 on {}: lowest point {lowest:.3} m", simulation.device().name());
/// # assert!((-0.9..-0.4).contains(&lowest), "{lowest}");
/// # Ok::<(), fnopt::Error>(())
/// ```
///
/// A host that draws on a device of its own takes [`sim::Solver`](crate::sim::Solver) instead, which records into the host's encoder.
pub struct Simulation {
    simulator: Simulator,
    device: Device,
    setups: Vec<Setup>,
    /// The last frame, or the start.
    frame: Frame,
    /// The last frame whose events have come, and what holds the handles of each cloth since then.
    entered: usize,
    anchors: Vec<Vec<f64>>,
    /// Where all bodies are by then; `None` as long as no host has led one.
    led: Option<Vec<Pose>>,
}

/// How a [`Simulation`] is computed.
#[derive(Clone, Debug)]
pub struct SimulationOptions {
    /// Iterations per frame; `None` for what suits the optimizer ([`Optimizer::default_iterations`]).
    pub iterations: Option<usize>,
    /// The device.
    pub device: DeviceChoice,
    /// Cloths of each scene, which begin alike.
    pub copies: usize,
}

impl Default for SimulationOptions {
    fn default() -> Self {
        Self { iterations: None, device: DeviceChoice::default(), copies: 1 }
    }
}

/// What a host prescribes for a frame, in SI units and each scene's axes; `None` for what the scene does.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Prescribed {
    /// Targets of the handles \[m\]: all of cloth 0, then of cloth 1, and so on. With `bodies`, those of handles that follow a body do not
    /// count: they go with it.
    pub handles: Option<Vec<[f64; 3]>>,
    /// Wind velocity of each cloth [m/s], gusts included. It moves cloths whose scene's `wind` has a density or a drag.
    pub wind: Option<Vec<[f64; 3]>>,
    /// Acceleration of each particle [m/s^2] in addition to gravity and air: all of cloth 0, then of cloth 1, and so on.
    pub accelerations: Option<Vec<[f64; 3]>>,
    /// Where the bodies are at the end of the frame: all of cloth 0, then of cloth 1, and so on. They move there from where the frame
    /// before left them, and handles that are attached to them go along. Rotations need not have length 1.
    pub bodies: Option<Vec<BodyPose>>,
}

/// A simulation at one of its frames, from which it goes on to the same bits: its state, what its optimizer remembers, and which events
/// have come. It is kept in memory.
#[derive(Clone, Debug)]
pub struct Snapshot {
    frame: Frame,
    memory: Memory,
    entered: usize,
    anchors: Vec<Vec<f64>>,
    led: Option<Vec<Pose>>,
}

/// The body that each handle of each cloth follows, if it follows one ([`Script::followed`]).
type Followed = Vec<Vec<Option<usize>>>;

impl Simulation {
    /// Sets up a scene with one cloth, on a hardware adapter if there is one, else on the CPU.
    ///
    /// Fails as [`Scene::setup`] and [`Simulator::on`] do.
    pub fn new(scene: &Scene, optimizer: &Optimizer) -> Result<Self> {
        Self::of(&[scene], optimizer, &SimulationOptions::default())
    }

    /// Sets up scenes whose cloths advance together, on grids and with frame times that are the same. Cloth `k` is of scene `k / copies`.
    ///
    /// Fails as [`Scene::setup`], [`Setup::batch`] and [`Simulator::on`] do.
    pub fn of(scenes: &[&Scene], optimizer: &Optimizer, options: &SimulationOptions) -> Result<Self> {
        let copies = options.copies;
        if copies == 0 {
            return Err(Error::invalid("simulation", "cloths", "at least one", 0));
        }
        let setups: Vec<Setup> = scenes.iter().map(|scene| scene.setup()).collect::<Result<_>>()?;
        // Refused before memory is taken for all of them.
        let particles: usize = setups.iter().map(|setup| setup.model.grid.particles()).sum();
        if particles.saturating_mul(copies) > u32::MAX as usize / 3 {
            return Err(Error::invalid("simulation", "cloths", "fewer particles in all", copies));
        }
        let setups: Vec<Setup> =
            setups.into_iter().flat_map(|setup| std::iter::repeat_n(setup, copies)).collect();
        let (scripts, batch) = Scripts::new(&setups)?;
        let anchors = anchors(&scripts);
        let iterations = options.iterations.unwrap_or(optimizer.default_iterations());
        let (simulator, opened) = Simulator::on(&options.device, &batch.model, optimizer, iterations)?;
        store_pipelines();
        let frame =
            Frame { index: 0, state: batch.start.cast(), stats: Vec::new(), wall: Default::default() };
        let mut new =
            Self { simulator, device: opened.device, setups, frame, entered: 0, anchors, led: None };
        new.simulator.set_state(&new.frame.state);
        Ok(new)
    }

    /// Returns the device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Returns the setup of each cloth.
    pub fn setups(&self) -> &[Setup] {
        &self.setups
    }

    /// Returns the number of particles of a cloth.
    pub fn particles(&self) -> usize {
        self.setups[0].model.grid.particles()
    }

    /// Returns the triangles of the first cloth; those of the others differ where their masks do.
    pub fn faces(&self) -> Vec<[u32; 3]> {
        let model = &self.setups[0].model;
        model.cloths[0].faces(model.grid)
    }

    /// Returns the last frame, or the start.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Returns the number of frames of the longest scene, including the start.
    pub fn frames(&self) -> usize {
        self.setups.iter().map(Setup::frames).max().unwrap_or(0)
    }

    /// Returns the cloths as they are now.
    pub fn cloths(&self) -> &[Cloth] {
        &self.simulator.model().cloths
    }

    /// Lets the events before the next frame come, and returns what the scenes do in it, and which handles follow bodies.
    fn next_control(&mut self) -> Result<(cloth::Control<f32>, Followed)> {
        let next = self.frame.index + 1;
        let mut scripts = Scripts::resume(&self.setups, self.entered, &self.anchors)?;
        if let Some(led) = &self.led {
            scripts.led_to(led);
        }
        if scripts.next_change().is_some_and(|change| change <= next)
            && let Some(cloths) = scripts.enter(next, &self.frame.state)
        {
            self.simulator.set_cloths(&cloths)?;
            (self.entered, self.anchors) = (next, anchors(&scripts));
        }
        Ok((scripts.control(next), scripts.each().iter().map(Script::followed).collect()))
    }

    /// Returns what the scenes do in the next frame, to be changed for [`Simulation::step_with`]. The events before it have come.
    pub fn prescribed(&mut self) -> Result<Prescribed> {
        let (control, _) = self.next_control()?;
        let model = self.simulator.model();
        let wide = |v: [f32; 3]| v.map(f64::from);
        let mut handles = Vec::with_capacity(control.handles.len());
        for (b, setup) in self.setups.iter().enumerate() {
            let own = &control.handles[model.handle_range(b)];
            handles.extend(own.iter().map(|&p| setup.up.from_z_up(setup.units.position_m(wide(p)))));
        }
        let wind = self.setups.iter().zip(&control.wind);
        let wind = wind.map(|(setup, &v)| setup.up.from_z_up(setup.units.velocity_m_s(wide(v)))).collect();
        let bodies = self.each_body().map(|(b, k)| self.setups[b].body_pose(&control.sweep(model, b, k).to));
        let bodies = Some(bodies.collect::<Vec<_>>()).filter(|bodies| !bodies.is_empty());
        Ok(Prescribed { handles: Some(handles), wind: Some(wind), accelerations: None, bodies })
    }

    /// Returns the bodies, each as the number of its cloth and its own there.
    fn each_body(&self) -> impl Iterator<Item = (usize, usize)> {
        let cloths = self.simulator.model().cloths.iter().enumerate();
        cloths.flat_map(|(b, cloth)| (0..cloth.bodies.len()).map(move |k| (b, k)))
    }

    /// Returns where the bodies are at the end of the last frame: all of cloth 0, then of cloth 1, and so on.
    pub fn bodies(&self) -> Vec<BodyPose> {
        let pose = |(at, (b, k)): (usize, (usize, usize))| {
            let pose =
                self.led.as_ref().map_or_else(|| self.setups[b].pose(k, self.frame.index), |led| led[at]);
            self.setups[b].body_pose(&pose)
        };
        self.each_body().enumerate().map(pose).collect()
    }

    /// Leads the bodies to these poses, or where the scenes have them, from where they are, with the handles that follow them, whose targets
    /// are those of the scenes until then. Returns where the bodies are in the end; `None` as long as no host leads any.
    fn lead_bodies(
        &self,
        given: Option<&[BodyPose]>,
        followed: &Followed,
        control: &mut cloth::Control<f32>,
    ) -> Result<Option<Vec<Pose>>> {
        if given.is_none() && self.led.is_none() {
            return Ok(None);
        }
        let model = self.simulator.model();
        if let Some(given) = given.filter(|given| given.len() != model.bodies()) {
            let expected = format!("{}, one for each body of all cloths together", model.bodies());
            return Err(Error::invalid("control", "bodies", expected, given.len()));
        }
        let mut sweeps = Vec::with_capacity(model.bodies());
        for (at, (b, k)) in self.each_body().enumerate() {
            let of_scene = control.sweep(model, b, k);
            let from = self.led.as_ref().map_or(of_scene.from, |led| led[at]);
            let to = match given {
                None => of_scene.to,
                Some(given) => {
                    let pose = given[at].normalised("control", format!("bodies[{at}].rotation"))?;
                    self.setups[b].pose_of(&pose)
                }
            };
            for (handle, _) in followed[b].iter().enumerate().filter(|(_, body)| **body == Some(k)) {
                let target = &mut control.handles[model.handle_range(b).start + handle];
                let own = of_scene.to.inward(target.map(f64::from).into());
                *target = to.outward(own).to_array().map(|c| c as f32);
            }
            sweeps.push(Sweep { from, to });
        }
        let led = sweeps.iter().map(|sweep| sweep.to).collect();
        control.bodies = sweeps;
        control.check(model)?;
        Ok(Some(led))
    }

    /// Computes the next frame as the scenes have it, events among it. After the last frame of a scene, handles and bodies stay where they
    /// are; bodies that a host has led go back to where the scene has them. Fails as [`Simulator::step`] does; a frame that is not finite
    /// can be looked at, and cloths be started again ([`Simulation::set_cloth_state`]).
    pub fn step(&mut self) -> Result<&Frame> {
        self.step_with(&Prescribed::default())
    }

    /// Computes the next frame as [`Simulation::step`] does, but for what `given` prescribes. Fails, too, if a length does not match or a
    /// number is not finite.
    pub fn step_with(&mut self, given: &Prescribed) -> Result<&Frame> {
        let (mut control, followed) = self.next_control()?;
        let led = self.lead_bodies(given.bodies.as_deref(), &followed, &mut control)?;
        let (setups, n) = (&self.setups, self.particles());
        let check = |field: &str, given: &[[f64; 3]], expected: usize, of: &str| {
            if given.len() != expected {
                return Err(Error::invalid("control", field, format!("{expected}, {of}"), given.len()));
            }
            match given.iter().position(|v| !v.iter().all(|c| (*c as f32).is_finite())) {
                Some(k) => {
                    let found = format!("{:?}", given[k]);
                    Err(Error::invalid("control", format!("{field}[{k}]"), "finite numbers", found))
                }
                None => Ok(()),
            }
        };
        if let Some(handles) = &given.handles {
            check("handles", handles, control.handles.len(), "one for each handle of all cloths together")?;
            let own = |b: usize| self.simulator.model().handle_range(b).zip(&followed[b]);
            for (b, setup) in setups.iter().enumerate() {
                for (k, _) in own(b).filter(|(_, body)| body.is_none() || given.bodies.is_none()) {
                    control.handles[k] = setup.handle_at(handles[k]);
                }
            }
        }
        if let Some(wind) = &given.wind {
            check("wind", wind, setups.len(), "one for each cloth")?;
            control.wind = setups.iter().zip(wind).map(|(setup, &v)| setup.wind_of(v)).collect();
        }
        if let Some(accelerations) = &given.accelerations {
            check("accelerations", accelerations, setups.len() * n, "one for each particle of all cloths")?;
            control.external = vec![0.0; 3 * accelerations.len()];
            let own = control.external.chunks_exact_mut(3 * n).zip(accelerations.chunks_exact(n));
            for (setup, (field, own)) in setups.iter().zip(own) {
                for (p, &a) in own.iter().enumerate() {
                    let a: [f32; 3] = setup.acceleration_of(a);
                    (0..3).for_each(|c| field[c * n + p] = a[c]);
                }
            }
        }
        match self.simulator.step(&control) {
            Ok(frame) => {
                (self.frame, self.led) = (frame, led);
                Ok(&self.frame)
            }
            Err(error) => {
                // A frame that ended badly has ended all the same.
                if self.simulator.frame() != self.frame.index
                    && let Ok(state) = self.simulator.state()
                {
                    (self.frame.index, self.frame.state, self.led) = (self.simulator.frame(), state, led);
                }
                Err(error)
            }
        }
    }

    /// Returns the positions \[m\] of the particles of all cloths, shape [B, H W], in each scene's axes: those of cloth `b` are the `b`-th
    /// [`Simulation::particles`] of them.
    pub fn positions(&self) -> Vec<[f32; 3]> {
        let mut positions = vec![[0.0; 3]; self.setups.len() * self.particles()];
        self.write_positions(positions.as_flattened_mut());
        positions
    }

    /// Returns the velocities [m/s] likewise.
    pub fn velocities(&self) -> Vec<[f32; 3]> {
        let mut velocities = vec![[0.0; 3]; self.setups.len() * self.particles()];
        self.write_velocities(velocities.as_flattened_mut());
        velocities
    }

    /// Writes the positions \[m\] of all cloths, shape [B, H W, 3], in each scene's axes. Panics if `out` is not as long.
    pub fn write_positions(&self, out: &mut [f32]) {
        self.convert(&self.frame.state.x, out, |setup, x| setup.vertices_m(x));
    }

    /// Writes the velocities [m/s] likewise.
    pub fn write_velocities(&self, out: &mut [f32]) {
        self.convert(&self.frame.state.v, out, |setup, v| setup.velocities_m_s(v));
    }

    fn convert(
        &self,
        field: &[f32],
        out: &mut [f32],
        points: impl Fn(&Setup, &[f32]) -> Vec<[f64; 3]> + Sync,
    ) {
        assert_eq!(field.len(), out.len(), "[B, H W, 3]");
        let len = 3 * self.particles();
        let one = |(setup, (own, out)): (&Setup, (&[f32], &mut [f32]))| {
            let points = points(setup, own);
            out.iter_mut().zip(points.as_flattened()).for_each(|(to, &from)| *to = from as f32);
        };
        match &*self.setups {
            // Without waking threads.
            [setup] => one((setup, (field, out))),
            setups => setups.par_iter().zip(field.par_chunks(len).zip(out.par_chunks_mut(len))).for_each(one),
        }
    }

    /// Returns a recording of cloth `b` without frames, of the mesh that it carries along if it has one, at the rate of the frames. Its
    /// temporary files are in `folder`. Fails if they cannot be created. Panics if there is no cloth `b`.
    ///
    /// ```
    /// use fnopt::io::{Format, WriteOptions};
    /// use fnopt::{Optimizer, Scene, Simulation};
    ///
    /// let mut simulation = Simulation::new(&Scene::default(), &Optimizer::spectral())?;
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let folder = folder.path();
    /// let mut recording = simulation.recording(0, folder)?;
    /// simulation.record(0, &mut recording)?; // the start
    /// for _ in 0..10 {
    ///     simulation.step()?;
    ///     simulation.record(0, &mut recording)?;
    /// }
    /// let options = WriteOptions::default();
    /// recording.write(folder, "sheet", Format::Usda, &options)?;
    /// recording.write(folder, "sheet", Format::Pc2, &options)?; // moves the vertices of a mesh:
    /// fnopt::io::write_mesh(&recording, folder.join("sheet.obj"))?;
    /// # assert!(["sheet.usda", "sheet.pc2", "sheet.obj"].iter().all(|name| folder.join(name).is_file()));
    /// # Ok::<(), fnopt::Error>(())
    /// ```
    pub fn recording(&self, b: usize, folder: impl AsRef<Path>) -> Result<Recording> {
        let setup = &self.setups[b];
        Recording::new(folder, setup.topology(), 1.0 / setup.units.frame_time_s)
    }

    /// Appends cloth `b` as it is now to a recording ([`Simulation::recording`]). Fails if the disk is full. Panics if there is no cloth
    /// `b`, or if the recording is of another mesh.
    pub fn record(&self, b: usize, recording: &mut Recording) -> Result<()> {
        let len = 3 * self.particles();
        let of = |field: &[f32]| field[b * len..][..len].to_vec();
        let own = State { x: of(&self.frame.state.x), v: of(&self.frame.state.v) };
        let [positions, velocities] = self.setups[b].points(&own);
        recording.push(&positions, &velocities)
    }

    /// Replaces the state of one cloth, given on its own grid in metres and metres per second; the optimizer forgets what it
    /// remembers of it. Frames are counted on.
    pub fn set_cloth_state(
        &mut self,
        b: usize,
        positions: &[[f64; 3]],
        velocities: &[[f64; 3]],
    ) -> Result<()> {
        let Some(setup) = self.setups.get(b) else {
            let expected = format!("0 to {}", self.setups.len() - 1);
            return Err(Error::invalid("state", "cloth", expected, b));
        };
        let state = setup.state_of(setup.model.grid, positions, velocities)?.cast();
        self.simulator.set_cloth_state(b, &state);
        let len = 3 * self.particles();
        self.frame.state.x[b * len..][..len].copy_from_slice(&state.x);
        self.frame.state.v[b * len..][..len].copy_from_slice(&state.v);
        Ok(())
    }

    /// Goes back to the start.
    pub fn reset(&mut self) -> Result<()> {
        let (scripts, batch) = Scripts::new(&self.setups)?;
        self.simulator.set_cloths(&batch.model.cloths)?;
        (self.entered, self.anchors, self.led) = (0, anchors(&scripts), None);
        self.frame =
            Frame { index: 0, state: batch.start.cast(), stats: Vec::new(), wall: Default::default() };
        self.simulator.set_state(&self.frame.state);
        Ok(())
    }

    /// Returns the simulation as it is now.
    pub fn snapshot(&mut self) -> Result<Snapshot> {
        Ok(Snapshot {
            frame: self.frame.clone(),
            memory: self.simulator.memory()?,
            entered: self.entered,
            anchors: self.anchors.clone(),
            led: self.led.clone(),
        })
    }

    /// Goes on from a snapshot of this simulation, or of one of the same scenes and solver. Fails, and changes nothing, if it has other
    /// sizes or is of another kind of solver; whether the scenes are the same is up to the caller.
    pub fn restore(&mut self, snapshot: &Snapshot) -> Result<()> {
        if snapshot.frame.state.x.len() != self.frame.state.x.len() {
            let of = |state: &State<f32>| format!("{} numbers", state.x.len());
            let (expected, found) = (of(&self.frame.state), of(&snapshot.frame.state));
            return Err(Error::invalid("snapshot", "state", expected, found));
        }
        let bodies = self.simulator.model().bodies();
        if let Some(led) = snapshot.led.as_ref().filter(|led| led.len() != bodies) {
            return Err(Error::invalid("snapshot", "bodies", bodies.to_string(), led.len()));
        }
        let scripts = Scripts::resume(&self.setups, snapshot.entered, &snapshot.anchors)?;
        let cloths: Vec<Cloth> = scripts.each().iter().map(|script| script.cloth().clone()).collect();
        let before = self.cloths().to_vec();
        self.simulator.set_cloths(&cloths)?;
        let resumed = self.simulator.resume(snapshot.frame.index, &snapshot.frame.state, &snapshot.memory);
        if let Err(error) = resumed {
            self.simulator.set_cloths(&before)?;
            return Err(error);
        }
        self.frame = snapshot.frame.clone();
        (self.entered, self.anchors) = (snapshot.entered, snapshot.anchors.clone());
        self.led = snapshot.led.clone();
        Ok(())
    }
}

fn anchors(scripts: &Scripts<'_>) -> Vec<Vec<f64>> {
    scripts.each().iter().map(|script: &Script<'_>| script.anchors().to_vec()).collect()
}
