//! A scene that runs: its solver, its course, and what the page changes of them. Nothing here waits.

use crate::scenes;
use crate::settings::Settings;
use fnopt::cloth::{Cloth, Control, Grid, State, Sweep};
use fnopt::glam::DVec3;
use fnopt::gpu::{Context, Readback};
use fnopt::network::Weights;
use fnopt::scene::{Motion, Scene, Script, Setup, Start};
use fnopt::sim::{FrameStats, Optimizer, Solver, Vertices};
use fnopt::{Error, Result, serde_json::Value, wgpu};
use std::collections::HashMap;

/// Frames that may be under way: with more, what the page does would show later.
const AHEAD: usize = 2;
/// Speed with which a handle follows the pointer [m/s].
const FOLLOWING: f64 = 6.0;
/// Particles of the finest grid on which a sheet is settled here, where that takes long.
const SETTLED: usize = 40 * 40;
/// Largest side of a grid, and most iterations, that the page asks of a device which also draws the browser.
const LARGEST: u64 = 256;
const MOST_ITERATIONS: u64 = 500;

/// What the page wants of a scene.
#[derive(Clone, Debug)]
pub struct Request {
    pub optimizer: Optimizer,
    pub iterations: usize,
    pub scene: Scene,
}

impl Request {
    /// Reads the options `{"solver", "iterations", "grid"}`, each of which may be left out or null: iterations are then those that
    /// suit the solver, and `grid`, the particles along the height, those of the scene. Fails on anything else.
    pub fn read(name: &str, options: &str) -> Result<Self> {
        let invalid =
            |field: &str, expected: String, found: &Value| Error::invalid("page", field, expected, found);
        let options: Value = fnopt::serde_json::from_str(options)
            .map_err(|error| Error::invalid("page", "options", "a JSON object", error))?;
        let fields = options.as_object();
        let fields = fields.ok_or_else(|| invalid("options", "an object".into(), &options))?;
        let known = ["solver", "iterations", "grid"];
        if let Some(field) = fields.keys().find(|field| !known.contains(&field.as_str())) {
            return Err(Error::unknown("page", "option", field, known));
        }
        let count = |field: &str, least: u64, most: u64| match &options[field] {
            Value::Null => Ok(None),
            value => {
                let found = value.as_u64().filter(|n| (least..=most).contains(n));
                let expected = || format!("a whole number, {least} to {most}");
                found.map(|n| Some(n as usize)).ok_or_else(|| invalid(field, expected(), value))
            }
        };
        let solver = match &options["solver"] {
            Value::Null => "fnopt",
            value => value.as_str().ok_or_else(|| invalid("solver", "a name".into(), value))?,
        };
        let optimizer = Optimizer::named(solver, "page", || Ok(Weights::shipped()))?;
        let iterations = count("iterations", 1, MOST_ITERATIONS)?;
        let iterations = iterations.unwrap_or_else(|| optimizer.default_iterations());
        let mut scene = scenes::find(name)?;
        if let Some(h) = count("grid", 8, LARGEST)? {
            // As many along the width as the sheet's shape takes.
            let Grid { h: of, w } = scene.grid;
            let w = 1 + ((w - 1) as f64 * (h - 1) as f64 / (of - 1) as f64).round() as usize;
            if (h, w) != (of, scene.grid.w) {
                scene.regrid(Grid::new(h, w, name)?)?;
            }
        }
        if scene.start == Start::Settled && scene.grid.particles() > SETTLED {
            scene.start = settled_coarsely(&scene)?;
        }
        Ok(Self { optimizer, iterations, scene })
    }
}

/// Returns the settled drape of a sheet, resampled from a coarser grid.
fn settled_coarsely(scene: &Scene) -> Result<Start> {
    let Grid { h, w } = scene.grid;
    let coarser = (SETTLED as f64 / (h * w) as f64).sqrt();
    let [h, w] = [h, w].map(|side| ((side as f64 * coarser) as usize).max(8));
    // The drape hangs from its corners, whatever holds or meets the sheet later.
    let mut sheet =
        Scene { motion: Motion::Still, attached: Vec::new(), events: Vec::new(), ..scene.clone() };
    sheet.bodies.clear();
    sheet.regrid(Grid::new(h, w, &scene.origin)?)?;
    let setup = sheet.setup()?;
    Ok(Start::Vertices(sheet.grid, setup.vertices_m(&setup.start.x)))
}

/// A scene on its way.
pub struct Session {
    pub setup: Setup,
    pub solver: Solver,
    pub vertices: Vertices,
    pub settings: Settings,
    /// How far from where the scene has it each handle is that was dragged \[edges\], by particle.
    dragged: HashMap<usize, DVec3>,
    /// A particle that is held beside the scene's handles, and where \[edges\].
    grabbed: Option<(usize, DVec3)>,
    /// The handles and where they are told to be \[edges\].
    targets: Vec<(usize, DVec3)>,
    sweeps: Vec<Sweep>,
    readback: Readback,
    /// Results on their way that belong to a run before the last reset.
    stale: usize,
    /// Numbers of the last frame computed, and of the last that has arrived, with its state.
    computed: usize,
    arrived: usize,
    state: State<f32>,
    stats: Option<FrameStats>,
    /// The last frame whose events have come, and what holds the handles since then.
    entered: usize,
    anchors: Vec<f64>,
}

impl Session {
    /// Sets up a scene and its solver.
    pub fn new(context: &Context, request: &Request) -> Result<Self> {
        let setup = request.scene.setup()?;
        let solver = Solver::new(context, &setup.model, &request.optimizer, request.iterations)?;
        let vertices = solver.vertices()?;
        // In metres, z up, as everything that the page draws.
        let mut view = fnopt::cloth::VertexView::default();
        (0..3).for_each(|axis| view.transform[axis][axis] = setup.units.length_m as f32);
        vertices.set_view(&view);
        let readback = Readback::new(context, &solver.frame_tensors(), AHEAD)?;
        let mut session = Self {
            state: setup.start.cast(),
            setup,
            solver,
            vertices,
            settings: Settings::default(),
            dragged: HashMap::new(),
            grabbed: None,
            targets: Vec::new(),
            sweeps: Vec::new(),
            readback,
            stale: 0,
            computed: 0,
            arrived: 0,
            stats: None,
            entered: 0,
            anchors: Vec::new(),
        };
        session.reset()?;
        Ok(session)
    }

    /// Begins again, with the page's settings and without its drags.
    pub fn reset(&mut self) -> Result<()> {
        self.stale += self.computed - self.arrived;
        (self.computed, self.arrived, self.entered) = (0, 0, 0);
        (self.state, self.stats) = (self.setup.start.cast(), None);
        self.anchors = Script::new(&self.setup).anchors().to_vec();
        self.dragged.clear();
        self.grabbed = None;
        self.apply()?;
        self.solver.set_state(&self.state);
        let control = self.setup.control(0);
        self.take(&control);
        Ok(())
    }

    /// Gives the solver the cloth as it is now.
    pub fn apply(&mut self) -> Result<()> {
        let mut cloth = self.settings.applied(&self.setup, self.cloth()?);
        self.grabbed = self.grabbed.filter(|(p, _)| !cloth.handles.contains(p));
        cloth.handles.extend(self.grabbed.map(|(p, _)| p));
        self.solver.set_cloths(&[cloth])
    }

    /// Holds a particle where it is, or lets the one go that was held.
    pub fn hold(&mut self, particle: Option<usize>) -> Result<()> {
        self.grabbed = particle.map(|p| (p, self.particle(p) / self.setup.units.length_m));
        self.apply()?;
        let places: HashMap<usize, DVec3> = self.targets.drain(..).chain(self.grabbed).collect();
        let handles = &self.solver.model().cloths[0].handles;
        self.targets = handles.iter().filter_map(|p| Some((*p, *places.get(p)?))).collect();
        Ok(())
    }

    /// Whether this particle is held, though it is none of the scene's handles.
    pub fn holds(&self, particle: usize) -> bool {
        self.grabbed.is_some_and(|(p, _)| p == particle)
    }

    fn script(&self) -> Result<Script<'_>> {
        Script::resume(&self.setup, self.entered, &self.anchors)
    }

    /// Returns the scene's own cloth as it is now.
    pub fn cloth(&self) -> Result<&Cloth> {
        Ok(self.script()?.cloth())
    }

    /// Returns the wind that the scene has now [edges / frame].
    pub fn wind(&self) -> Result<[f32; 3]> {
        Ok(self.script()?.control(self.computed).wind.first().copied().unwrap_or_default())
    }

    /// Whether the next frame can be computed. Where something changes before it, the last one must have arrived.
    pub fn is_ready(&self) -> Result<bool> {
        let changes = self.script()?.next_change().is_some_and(|frame| frame <= self.computed + 1);
        Ok(!self.readback.is_full() && (!changes || self.arrived == self.computed))
    }

    /// Whether the device is behind.
    pub fn is_behind(&self) -> bool {
        self.readback.is_full()
    }

    /// Prepares the next frame.
    pub fn enter_frame(&mut self) -> Result<()> {
        let frame = self.computed + 1;
        let mut script = self.script()?;
        if script.next_change().is_some_and(|change| change <= frame)
            && script.enter(frame, &self.state).is_some()
        {
            let anchors = script.anchors().to_vec();
            (self.entered, self.anchors) = (frame, anchors);
            self.apply()?;
        }
        let mut control: Control<f32> = self.script()?.control(frame);
        let handles = &self.cloth()?.handles;
        for (p, at) in handles.iter().zip(&mut control.handles) {
            if let Some(offset) = self.dragged.get(p) {
                *at = (DVec3::from(at.map(f64::from)) + offset).as_vec3().to_array();
            }
        }
        control.handles.extend(self.grabbed.map(|(_, at)| at.as_vec3().to_array()));
        control.wind.iter_mut().for_each(|wind| *wind = self.settings.wind(&self.setup, *wind));
        self.take(&control);
        self.solver.set_control(&control);
        self.computed = frame;
        Ok(())
    }

    /// Remembers where a control puts handles and bodies.
    fn take(&mut self, control: &Control<f32>) {
        let handles = &self.solver.model().cloths[0].handles;
        let at = control.handles.iter().map(|at| DVec3::from(at.map(f64::from)));
        self.targets = handles.iter().copied().zip(at).collect();
        self.sweeps = control.bodies.clone();
    }

    /// Records the next frame, after [`Session::enter_frame`].
    pub fn record(&mut self, encoder: &mut wgpu::CommandEncoder) {
        self.solver.record(encoder);
        self.readback.record(encoder);
    }

    /// Takes note of the submission of what was recorded.
    pub fn submitted(&mut self, submission: &wgpu::SubmissionIndex) {
        self.readback.submitted(submission);
    }

    /// Takes the frames that have arrived. Fails on the first that is not finite.
    pub fn collect(&mut self) -> Result<()> {
        while let Some((state, stats)) = self.readback.try_next(|bytes| self.solver.frame(bytes))? {
            if self.stale > 0 {
                self.stale -= 1;
                continue;
            }
            self.arrived += 1;
            self.state = state;
            self.stats = stats.into_iter().next();
            let finite = self.state.x.iter().all(|x| x.is_finite());
            if !finite || !self.stats.as_ref().is_some_and(FrameStats::is_finite) {
                return Err(Error::NonFinite { frame: self.arrived, cloth: 0 });
            }
        }
        Ok(())
    }

    /// Returns the number of the last frame that has arrived, its state and its statistics.
    pub fn latest(&self) -> (usize, &State<f32>, Option<&FrameStats>) {
        (self.arrived, &self.state, self.stats.as_ref())
    }

    /// Whether the scene's last frame has arrived.
    pub fn is_over(&self) -> bool {
        self.arrived + 1 >= self.setup.frames()
    }

    /// Returns the handles and where they are told to be \[m\], z up.
    pub fn handles(&self) -> impl Iterator<Item = (usize, DVec3)> + Clone {
        self.targets.iter().map(|(p, at)| (*p, *at * self.setup.units.length_m))
    }

    /// Returns how each body that is there lies now, by its number.
    pub fn bodies(&self) -> impl Iterator<Item = (usize, fnopt::cloth::Pose)> {
        let bodies = self.solver.model().cloths[0].bodies.iter().enumerate();
        let present = bodies.filter(|(_, body)| body.present);
        present.map(|(k, body)| (k, self.sweeps.get(k).map_or(body.pose, |sweep| sweep.to)))
    }

    /// Moves a handle towards a point \[m\], z up, by as much as it may move in a frame. Whether it is there.
    pub fn pull(&mut self, particle: usize, to: DVec3) -> bool {
        let units = self.setup.units;
        let most = FOLLOWING * units.frame_time_s / units.length_m;
        let Some(&(_, at)) = self.targets.iter().find(|(p, _)| *p == particle) else { return true };
        let way = to / units.length_m - at;
        let step = way.clamp_length_max(most);
        match &mut self.grabbed {
            Some((p, at)) if *p == particle => *at += step,
            _ => *self.dragged.entry(particle).or_default() += step,
        }
        way.length() <= most
    }

    /// Returns where a particle was in the last frame that has arrived \[m\], z up.
    pub fn particle(&self, p: usize) -> DVec3 {
        let n = self.setup.model.grid.particles();
        let at = [p, n + p, 2 * n + p].map(|k| f64::from(self.state.x[k]));
        DVec3::from(at) * self.setup.units.length_m
    }
}
