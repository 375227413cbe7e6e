//! What holds a cloth besides its motion, and what changes on the way, in SI units and the scene's axes.

use super::file::{read_gravity, read_handles, read_stiffness, read_wind};
use super::script::{Change, Lead};
use super::{Airflow, Handles, Placement, Scene, Stiffness, Units, UpAxis, Wind};
use crate::cloth::{Cloth, Grid};
use crate::io::Node;
use crate::{Error, Result};
use serde_json::{Value, json};
use std::collections::{BTreeSet, HashMap};

/// Handles that follow a body from the start on, each as if it were glued to it where it begins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// Number of the body in the scene.
    pub body: usize,
    /// Numbers of the handles in the scene's list of them; `None` for all.
    pub handles: Option<Vec<usize>>,
}

/// Something that changes on the way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Event {
    /// The first frame with the change; the start is frame 0.
    pub frame: usize,
    /// Handles that are let go.
    pub release: Option<Release>,
    /// Particles that become handles.
    pub grab: Option<Handles>,
    /// The body that the grabbed particles follow; `None` if they stay where they are.
    pub body: Option<usize>,
    /// The air and its motion from then on.
    pub wind: Option<Wind>,
    /// Gravity from then on [m/s^2].
    pub gravity: Option<[f64; 3]>,
    /// Stiffness of the sheet from then on.
    pub stiffness: Option<Stiffness>,
    /// Bodies that are not there from then on.
    pub hide: Vec<usize>,
    /// Bodies that are there from then on.
    pub show: Vec<usize>,
}

/// Handles that are let go.
#[derive(Clone, Debug, PartialEq)]
pub enum Release {
    /// All of them.
    All,
    /// Those at these particles.
    At(Handles),
}

impl Attachment {
    /// Reads the attachments of a scene file.
    pub(super) fn read(node: &Node) -> Result<Self> {
        node.deny_unknown(&["body", "handles"])?;
        let body = node.get("body").ok_or_else(|| node.invalid("a \"body\", its number in \"bodies\""))?;
        let handles = node.get_or("handles", None, |n| {
            n.items()?.iter().map(Node::count).collect::<Result<_>>().map(Some)
        })?;
        Ok(Self { body: body.count()?, handles })
    }

    /// Gives its handles their new numbers, given which old one was `seen` for each new one: of those that have become one,
    /// the first counts. A number that is not that of a handle stays, to be refused.
    pub(super) fn renumber(&mut self, numbers: &[usize], seen: &mut HashMap<usize, usize>) {
        if let Some(handles) = &mut self.handles {
            handles.retain_mut(|handle| {
                let old = *handle;
                let Some(&new) = numbers.get(old) else { return true };
                *handle = new;
                *seen.entry(new).or_insert(old) == old
            });
        }
    }

    /// Returns the attachment as [`Attachment::read`] reads it.
    pub(super) fn to_json(&self) -> Value {
        let mut document = json!({ "body": self.body });
        if let Some(handles) = &self.handles {
            document["handles"] = json!(handles);
        }
        document
    }
}

impl Event {
    /// Reads an event of a scene file with this axis up.
    pub(super) fn read(node: &Node, up: UpAxis) -> Result<Self> {
        node.deny_unknown(&[
            "frame", "release", "grab", "body", "wind", "gravity", "material", "hide", "show",
        ])?;
        let frame =
            node.get("frame").ok_or_else(|| node.invalid("a \"frame\", the first one with the change"))?;
        let numbers = |n: &Node| n.items()?.iter().map(Node::count).collect::<Result<Vec<usize>>>();
        let release = |n: &Node| match n.value {
            Value::String(all) if all == "all" => Ok(Some(Release::All)),
            Value::String(name) if Placement::named(name, n.origin).is_err() => Err(Error::unknown(
                format!("{}: {}", n.origin, n.path),
                "handles",
                name,
                Placement::ALL.map(Placement::name).into_iter().chain(["all"]),
            )),
            _ => read_handles(n).map(|handles| Some(Release::At(handles))),
        };
        Ok(Self {
            frame: frame.count()?,
            release: node.get_or("release", None, release)?,
            grab: node.get_or("grab", None, |n| read_handles(n).map(Some))?,
            body: node.get_or("body", None, |n| n.count().map(Some))?,
            wind: node.get_or("wind", None, |n| read_wind(n).map(Some))?,
            gravity: node.get_or("gravity", None, |n| read_gravity(n, up).map(Some))?,
            stiffness: node.get_or("material", None, |n| read_stiffness(n).map(Some))?,
            hide: node.get_or("hide", Vec::new(), numbers)?,
            show: node.get_or("show", Vec::new(), numbers)?,
        })
    }

    /// Returns the event as [`Event::read`] reads it.
    pub(super) fn to_json(&self) -> Value {
        let mut document = json!({ "frame": self.frame });
        let mut set = |field: &str, value: Option<Value>| {
            if let Some(value) = value {
                document[field] = value;
            }
        };
        set(
            "release",
            self.release.as_ref().map(|release| match release {
                Release::All => json!("all"),
                Release::At(handles) => handles.to_json(),
            }),
        );
        set("grab", self.grab.as_ref().map(Handles::to_json));
        set("body", self.body.map(|body| json!(body)));
        set("wind", self.wind.map(|wind| json!(wind)));
        set("gravity", self.gravity.map(|gravity| json!(gravity)));
        set("material", self.stiffness.map(|stiffness| stiffness.to_json()));
        set("hide", (!self.hide.is_empty()).then(|| json!(self.hide)));
        set("show", (!self.show.is_empty()).then(|| json!(self.show)));
        document
    }

    /// Moves the particles that it names to another grid.
    pub(super) fn regrid(&mut self, from: Grid, to: Grid) {
        if let Some(Release::At(handles)) = &mut self.release {
            (*handles, _) = handles.regrid(from, to, true);
        }
        if let Some(handles) = &mut self.grab {
            (*handles, _) = handles.regrid(from, to, true);
        }
    }
}

impl Scene {
    /// Returns which body each of `handles` handles follows from the start on.
    pub(super) fn attached_bodies(&self, handles: usize) -> Result<Vec<Option<usize>>> {
        let mut bodies = vec![None; handles];
        for (k, Attachment { body, handles: own }) in self.attached.iter().enumerate() {
            let field = format!("attached[{k}]");
            self.body(&format!("{field}.body"), *body)?;
            let all: Vec<usize> = own.clone().unwrap_or_else(|| (0..handles).collect());
            for (place, &handle) in all.iter().enumerate() {
                let refused = |expected: String| {
                    Err(Error::invalid(&self.origin, format!("{field}.handles[{place}]"), expected, handle))
                };
                match bodies.get_mut(handle) {
                    None => {
                        return refused(format!("the number of one of {handles} handles, below {handles}"));
                    }
                    Some(Some(_)) => return refused("a handle that is not attached yet".into()),
                    Some(of) => *of = Some(*body),
                }
            }
        }
        Ok(bodies)
    }

    fn body(&self, field: &str, body: usize) -> Result<usize> {
        match self.bodies.len() {
            count if body < count => Ok(body),
            0 => Err(Error::invalid(&self.origin, field, "a scene with \"bodies\"", body)),
            count => {
                let expected = format!("the number of one of {count} bodies, below {count}");
                Err(Error::invalid(&self.origin, field, expected, body))
            }
        }
    }

    /// Returns the changes that the events make in a scene of `frames` frames, given the cloth and the wind at its start.
    pub(super) fn changes(
        &self,
        units: &Units,
        frames: usize,
        (cloth, wind): (&Cloth, Airflow),
    ) -> Result<Vec<Change>> {
        let mut now = Change {
            frame: 0,
            leads: (0..cloth.handles.len()).map(Lead::Motion).collect(),
            cloth: cloth.clone(),
            wind,
        };
        let mut changes: Vec<Change> = Vec::new();
        for (k, event) in self.events.iter().enumerate() {
            let field = |part: &str| format!("events[{k}].{part}");
            let refused = |part: &str, expected: String, found: String| {
                Err(Error::invalid(&self.origin, field(part), expected, found))
            };
            if !(1..frames).contains(&event.frame) {
                let expected = match frames {
                    1 => "no events in a scene of one frame".to_owned(),
                    _ => format!("1 to {}, the last frame of the scene", frames - 1),
                };
                return refused("frame", expected, event.frame.to_string());
            }
            if event.frame < now.frame {
                let expected = format!("{} or later, in the order of time", now.frame);
                return refused("frame", expected, event.frame.to_string());
            }
            now.frame = event.frame;
            self.change(&mut now, event, units, &field)?;
            changes.retain(|change| change.frame < now.frame);
            changes.push(now.clone());
        }
        Ok(changes)
    }

    /// Changes what holds before an event to what holds after it. `field` names a part of it.
    fn change(
        &self,
        now: &mut Change,
        event: &Event,
        units: &Units,
        field: &dyn Fn(&str) -> String,
    ) -> Result<()> {
        let grid = self.grid;
        let cell = |p: usize| format!("({}, {})", p / grid.w, p % grid.w);
        let named =
            |handles: &Handles, part: &str| handles.on(grid, &format!("{}: {}", self.origin, field(part)));
        if let Some(release) = &event.release {
            let gone = match release {
                Release::All => now.cloth.handles.clone(),
                Release::At(handles) => named(handles, "release")?,
            };
            if let Some(free) = gone.iter().find(|p| !now.cloth.handles.contains(p)) {
                return Err(Error::invalid(
                    &self.origin,
                    field("release"),
                    "particles that are held",
                    cell(*free),
                ));
            }
            let gone: BTreeSet<usize> = gone.into_iter().collect();
            let held = now.cloth.handles.iter().copied().zip(now.leads.iter().copied());
            (now.cloth.handles, now.leads) = held.filter(|(p, _)| !gone.contains(p)).unzip();
        }
        if let Some(body) = event.body {
            self.body(&field("body"), body)?;
            if event.grab.is_none() {
                return Err(Error::invalid(
                    &self.origin,
                    field("body"),
                    "particles to \"grab\" with it",
                    body,
                ));
            }
        }
        if let Some(handles) = &event.grab {
            let held: BTreeSet<usize> = now.cloth.handles.iter().copied().collect();
            let grabbed = named(handles, "grab")?;
            if let Some(already) = grabbed.iter().find(|p| held.contains(p)) {
                let expected = "particles that are not held yet";
                return Err(Error::invalid(&self.origin, field("grab"), expected, cell(*already)));
            }
            now.leads.extend(grabbed.iter().map(|_| event.body.map_or(Lead::Place, Lead::Body)));
            now.cloth.handles.extend(grabbed);
        }
        if let Some(wind) = event.wind {
            self.check_wind(&field("wind"), &wind)?;
            now.wind = Airflow::new(&wind, units, self.up);
            now.cloth.air = units.air(wind.density, wind.drag);
        }
        if let Some(gravity) = event.gravity {
            self.finite(&field("gravity"), gravity)?;
            now.cloth.gravity = units.acceleration(self.up.to_z_up(gravity));
        }
        if let Some(stiffness) = event.stiffness {
            self.check_stiffness(&field("material"), stiffness)?;
            now.cloth.material = stiffness.in_grid_units(units, grid);
        }
        for (part, bodies, present) in [("hide", &event.hide, false), ("show", &event.show, true)] {
            for (place, &body) in bodies.iter().enumerate() {
                self.body(&field(&format!("{part}[{place}]")), body)?;
                now.cloth.bodies[body].present = present;
            }
        }
        self.check_units(units, &now.cloth, now.wind)
    }
}
