//! What a scene does in each frame: the positions of its handles, and what changes on the way.

use super::setup::sweeps;
use super::{Airflow, Batch, Setup};
use crate::cloth::{Cloth, Control, Pose, State, Sweep, cast};
use crate::{Error, Result};
use glam::DVec3;
use num_traits::Float;

/// What changes before a frame of a scene ([`Setup::changes`]).
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// The first frame with the change: that at whose end it can be seen.
    pub frame: usize,
    /// The cloth from then on. It has the bodies of the cloth at the start.
    pub cloth: Cloth,
    /// The wind from then on.
    pub wind: Airflow,
    /// Where each handle of the cloth goes from then on, in their order.
    pub leads: Vec<Lead>,
}

/// What a handle follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lead {
    /// The positions of this handle in [`Setup::handles`].
    Motion(usize),
    /// Nothing: it stays where it was grabbed.
    Place,
    /// The body of this number: it stays at the point of it where it was grabbed.
    Body(usize),
}

/// The course of a scene, frame by frame.
///
/// Where a cloth is grabbed depends on where it is by then, so a script is told ([`Script::enter`]);
/// [`Simulator::play`](crate::Simulator::play) does that.
#[derive(Clone, Debug)]
pub struct Script<'a> {
    setup: &'a Setup,
    /// Number of the changes that have come.
    changes: usize,
    /// For each handle where it was grabbed: a point of space, or of a body's own axes; unused for those of a motion.
    anchors: Vec<[f64; 3]>,
    /// Where the bodies are, if a host has led them elsewhere than the scene has them.
    led: Vec<Pose>,
}

impl<'a> Script<'a> {
    /// Returns the course of a scene from its start.
    pub fn new(setup: &'a Setup) -> Self {
        let anchors = vec![[0.0; 3]; setup.model.cloths[0].handles.len()];
        Self { setup, changes: 0, anchors, led: Vec::new() }
    }

    /// Returns the course of a scene after its frame `frame`, with the anchors that it had there
    /// ([`Script::anchors`]). Fails if they are not three finite numbers for each handle.
    pub fn resume(setup: &'a Setup, frame: usize, anchors: &[f64]) -> Result<Self> {
        let changes = setup.changes.partition_point(|change| change.frame <= frame);
        let mut script = Self { changes, ..Self::new(setup) };
        let handles = script.cloth().handles.len();
        if anchors.len() != 3 * handles || !anchors.iter().all(|c| c.is_finite()) {
            let expected = format!("{} finite numbers", 3 * handles);
            return Err(Error::invalid("script", "anchors", expected, format!("{} numbers", anchors.len())));
        }
        script.anchors = anchors.chunks_exact(3).map(|at| [at[0], at[1], at[2]]).collect();
        Ok(script)
    }

    /// Returns where the handles were grabbed, in an order of its own: with it, [`Script::resume`] goes on.
    pub fn anchors(&self) -> &[f64] {
        self.anchors.as_flattened()
    }

    /// Returns the setup.
    pub fn setup(&self) -> &'a Setup {
        self.setup
    }

    /// Returns the frame before which something changes next.
    pub fn next_change(&self) -> Option<usize> {
        self.setup.changes.get(self.changes).map(|change| change.frame)
    }

    /// Returns the cloth as it is now.
    pub fn cloth(&self) -> &'a Cloth {
        self.now().map_or(&self.setup.model.cloths[0], |change| &change.cloth)
    }

    /// Returns the body that each handle of the cloth follows now, if it follows one.
    pub fn followed(&self) -> Vec<Option<usize>> {
        let body = |lead: &Lead| match *lead {
            Lead::Motion(handle) => self.setup.attached[handle],
            Lead::Place => None,
            Lead::Body(body) => Some(body),
        };
        self.now()
            .map_or_else(|| self.setup.attached.clone(), |change| change.leads.iter().map(body).collect())
    }

    fn now(&self) -> Option<&'a Change> {
        self.changes.checked_sub(1).map(|k| &self.setup.changes[k])
    }

    /// Makes the changes before `frame`, given the state at its start, and returns the cloth if there are any.
    pub fn enter<T: Float>(&mut self, frame: usize, start: &State<T>) -> Option<&'a Cloth> {
        let mut entered = None;
        while let Some(change) = self.setup.changes.get(self.changes).filter(|change| change.frame <= frame) {
            let before = self.cloth();
            let n = start.x.len() / 3;
            let held = |p: &usize| before.handles.iter().position(|q| q == p);
            let anchor = |(p, lead): (&usize, &Lead)| {
                if let Some(k) = held(p) {
                    return self.anchors[k];
                }
                let place = [*p, n + p, 2 * n + p].map(|k| cast(start.x[k]));
                match *lead {
                    Lead::Body(body) => {
                        let pose = self.led.get(body).copied();
                        let pose = pose.unwrap_or_else(|| self.setup.pose(body, frame - 1));
                        pose.inward(DVec3::from(place)).to_array()
                    }
                    Lead::Motion(_) | Lead::Place => place,
                }
            };
            self.anchors = change.cloth.handles.iter().zip(&change.leads).map(anchor).collect();
            self.changes += 1;
            entered = Some(&change.cloth);
        }
        entered
    }

    /// Returns the control of the step that ends at `frame`, before which nothing may change that has not been entered.
    /// Past the end, the handles keep their last positions.
    pub fn control<T: Float>(&self, frame: usize) -> Control<T> {
        let Some(change) = self.now() else { return self.setup.control(frame) };
        let setup = self.setup;
        let row = setup.handles.get(frame).or(setup.handles.last());
        let place = |(lead, anchor): (&Lead, &[f64; 3])| match *lead {
            Lead::Motion(handle) => row.map_or(*anchor, |row| row[handle]),
            Lead::Place => *anchor,
            Lead::Body(body) => setup.pose(body, frame).outward(DVec3::from(*anchor)).to_array(),
        };
        Control {
            handles: change.leads.iter().zip(&self.anchors).map(|held| place(held).map(cast)).collect(),
            wind: vec![change.wind.at(frame).map(cast)],
            external: Vec::new(),
            bodies: sweeps(&setup.poses, frame),
        }
    }
}

/// The courses of several scenes, whose cloths advance together ([`Setup::batch`]).
#[derive(Clone, Debug)]
pub struct Scripts<'a> {
    each: Vec<Script<'a>>,
    frames: usize,
}

impl<'a> Scripts<'a> {
    /// Returns the courses from their start on, and the batch of their cloths, for which a simulator is to be built. Fails
    /// as [`Setup::batch`] does, but for events.
    pub fn new(setups: &'a [Setup]) -> Result<(Self, Batch)> {
        let batch = Setup::together(setups)?;
        Ok((Self { each: setups.iter().map(Script::new).collect(), frames: batch.frames() }, batch))
    }

    /// Returns the courses after frame `frame`, with the anchors that each had there ([`Script::anchors`]). Fails as
    /// [`Script::resume`] does, or if there are not as many anchors as scenes.
    pub fn resume(setups: &'a [Setup], frame: usize, anchors: &[Vec<f64>]) -> Result<Self> {
        if anchors.len() != setups.len() {
            let expected = format!("those of {} scenes", setups.len());
            return Err(Error::invalid("scripts", "anchors", expected, anchors.len()));
        }
        let resume = |(setup, anchors): (&'a Setup, &Vec<f64>)| Script::resume(setup, frame, anchors);
        let each = setups.iter().zip(anchors).map(resume).collect::<Result<_>>()?;
        Ok(Self { each, frames: setups.iter().map(Setup::frames).max().unwrap_or(0) })
    }

    /// Tells the courses where a host has led the bodies: all bodies of the first scene, then of the next, and so on.
    pub fn led_to(&mut self, mut poses: &[Pose]) {
        for script in &mut self.each {
            let (own, rest) = poses.split_at(script.cloth().bodies.len());
            (script.led, poses) = (own.to_vec(), rest);
        }
    }

    /// Returns the course of each scene.
    pub fn each(&self) -> &[Script<'a>] {
        &self.each
    }
}

/// What a simulation goes through: that of one scene ([`Script`]), or of several ([`Scripts`]).
pub trait Course {
    /// Returns the number of frames, including the start.
    fn frames(&self) -> usize;

    /// Returns the frame before which something changes next.
    fn next_change(&self) -> Option<usize>;

    /// Makes the changes before `frame`, given the state of all cloths at its start, and returns the cloths if there are
    /// any.
    fn enter(&mut self, frame: usize, start: &State<f32>) -> Option<Vec<Cloth>>;

    /// Returns the control of the step that ends at `frame`, before which nothing may change that has not been entered.
    fn control(&self, frame: usize) -> Control<f32>;
}

impl Course for Script<'_> {
    fn frames(&self) -> usize {
        self.setup.frames()
    }

    fn next_change(&self) -> Option<usize> {
        self.next_change()
    }

    fn enter(&mut self, frame: usize, start: &State<f32>) -> Option<Vec<Cloth>> {
        self.enter(frame, start).map(|cloth| vec![cloth.clone()])
    }

    fn control(&self, frame: usize) -> Control<f32> {
        self.control(frame)
    }
}

impl Course for Scripts<'_> {
    fn frames(&self) -> usize {
        self.frames
    }

    fn next_change(&self) -> Option<usize> {
        self.each.iter().filter_map(Script::next_change).min()
    }

    fn enter(&mut self, frame: usize, start: &State<f32>) -> Option<Vec<Cloth>> {
        let len = start.x.len() / self.each.len();
        let mut entered = false;
        for (b, script) in self.each.iter_mut().enumerate() {
            if script.next_change().is_some_and(|next| next <= frame) {
                let own = |field: &[f32]| field[b * len..(b + 1) * len].to_vec();
                script.enter(frame, &State { x: own(&start.x), v: own(&start.v) });
                entered = true;
            }
        }
        entered.then(|| self.each.iter().map(|script| script.cloth().clone()).collect())
    }

    fn control(&self, frame: usize) -> Control<f32> {
        let mut all = Control::default();
        let each: Vec<Control<f32>> = self.each.iter().map(|script| script.control(frame)).collect();
        let moves = each.iter().any(|control| !control.bodies.is_empty());
        for (script, own) in self.each.iter().zip(each) {
            all.handles.extend(own.handles);
            all.wind.extend(own.wind);
            // None are given for bodies that never move.
            match own.bodies.is_empty() && moves {
                true => all.bodies.extend(script.cloth().bodies.iter().map(|body| Sweep::still(body.pose))),
                false => all.bodies.extend(own.bodies),
            }
        }
        all
    }
}
