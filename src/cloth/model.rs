//! What stays fixed during a run, what changes, and what drives a frame. Grid units throughout, z up.

use super::terms::Contact;
use super::{Body, Grid, MAX_BODIES, Map, Mark, Mask, RestAngles, Sweep, Weave};
use crate::{Error, Result};
use num_traits::Float;
use std::collections::HashSet;
use std::ops::Range;

/// Energy coefficients in grid units, the paper's material parameters; see
/// [`EnergyTerms`](super::EnergyTerms) for the energy.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Material {
    /// Stretch coefficient `k_stretch`.
    pub stretch: f64,
    /// Shear coefficient `k_shear`.
    pub shear: f64,
    /// Bend coefficient `k_bend`.
    pub bend: f64,
    /// How stretch and bend differ between the axes of the grid.
    #[serde(skip_serializing_if = "Weave::is_even")]
    pub weave: Weave,
}

impl Material {
    /// The typical material of the paper: (1000, 8, 0.5).
    pub const PAPER: Self = Self { stretch: 1000.0, shear: 8.0, bend: 0.5, weave: Weave::EVEN };

    /// Returns the coefficients of the stretch of edges along the height and along the width.
    pub fn stretches(&self) -> [f64; 2] {
        self.weave.stretch.map(|factor| factor * self.stretch)
    }

    /// Returns the coefficients of the bend along the height and along the width.
    pub fn bends(&self) -> [f64; 2] {
        self.weave.bend.map(|factor| factor * self.bend)
    }
}

impl Default for Material {
    /// Returns [`Material::PAPER`].
    fn default() -> Self {
        Self::PAPER
    }
}

/// The air around a cloth, in grid units. The coefficients are already divided by the mass of a cell of the
/// sheet, so that `density * area * |v_n| v_n n + drag * area * v_tangential`, divided by a particle's grid
/// mass, is an acceleration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Air {
    /// Pressure coefficient of the normal component: `air density * spacing / areal mass`.
    pub density: f64,
    /// Friction coefficient of the tangential component: `drag * frame time / areal mass`.
    pub drag: f64,
}

/// A repulsion that keeps the layers of a cloth apart (paper section 3.4): nearby particles repel each other
/// unless an edge of the triangulated grid joins them. See
/// [`EnergyTerms::repulsion`](super::EnergyTerms::repulsion) for the energy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Repulsion {
    /// Coefficient `k_repulsion` of the energy [edges^2 / frame^2]: the paper's `lambda` times the number of
    /// particles, so that the push on a particle does not depend on their number.
    pub strength: f64,
    /// Distance below which particles repel each other \[edges\], the paper's `delta`: 0.001 to 1, the rest
    /// length of an edge.
    pub distance: f64,
}

impl Repulsion {
    /// Added to a squared distance [edges^2], so that the repulsion of coincident particles is finite.
    pub(crate) const SOFTENING: f64 = 1e-8;

    /// Fails if a number is out of range; `origin` and `field` name its source in the error.
    pub(crate) fn check(&self, origin: &str, field: &str) -> Result<()> {
        let Self { strength, distance } = *self;
        let refused = |part: &str, expected: &str, found: f64| {
            Err(Error::invalid(origin, format!("{field}.{part}"), expected, found))
        };
        // The mass of a corner is 1/4 of its density, so the factor 4 k / m of its push is at most this.
        if !(strength >= 0.0 && ((16.0 * strength / Map::RANGE[0]) as f32).is_finite()) {
            return refused("strength", "0 or more, and finite in single precision", strength);
        }
        if !(0.001..=1.0).contains(&distance) {
            return refused("distance", "0.001 to 1 edges", distance);
        }
        Ok(())
    }
}

/// Contact of a cloth with itself: its particles with its triangles, and its edges with each other, as with bodies
/// ([`Contact`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SelfContact {
    /// Distance at which layers begin to push each other apart \[edges\], 0.001 to 0.5.
    pub thickness: f64,
    /// Coefficient of friction between layers, 0 to 100.
    pub friction: f64,
}

impl SelfContact {
    /// Most pairs of parts near each other for each particle of a cloth, on average; a crumpled one has some twenty.
    pub const MOST_PAIRS: usize = 128;

    /// How far beyond the thickness a pair of parts is still a contact of the frame \[edges\]: by as much an optimizer
    /// may change what the velocities predict.
    pub(crate) const MARGIN: f64 = 0.25;

    /// Share of half the distance within which pairs were searched by which a particle may leave the way that it was
    /// expected to take.
    pub(crate) const BUDGET: f64 = 0.85;

    /// Share of the thickness at which a pair counts as met on its way.
    pub(crate) const NEAR: f64 = 0.5;

    /// What a particle has of the resistance of a pair, about: it is one of three or four. All of it leaves three times
    /// as much of the gap of a sheet that hangs freely as none does, this a quarter more with five iterations and no more with ten.
    pub(crate) const SHARE: f64 = 0.3;

    /// Fails if a number is out of range; `origin` and `field` name its source in the error.
    pub(crate) fn check(&self, origin: &str, field: &str) -> Result<()> {
        let refused = |part: &str, expected: &str, found: f64| {
            Err(Error::invalid(origin, format!("{field}.{part}"), expected, found))
        };
        if !(0.001..=0.5).contains(&self.thickness) {
            return refused("thickness", "0.001 to 0.5 edges", self.thickness);
        }
        if !(0.0..=100.0).contains(&self.friction) {
            return refused("friction", "0 to 100", self.friction);
        }
        Ok(())
    }
}

/// The constants of one cloth of a batch, which no frame changes;
/// [`Solver::set_cloths`](crate::sim::Solver::set_cloths) replaces them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloth {
    /// Energy coefficients.
    pub material: Material,
    /// How long the stretch of its edges resists its own change \[frames\]: an edge adds `c damping (|e| - |e0|)^2` to the
    /// energy of a frame, where c is the coefficient of its stretch and e0 the edge at the start of the frame.
    pub damping: f64,
    /// Factors of the masses of its particles; `None` for 1.
    pub density: Option<Map>,
    /// Factors of its stretch, shear and bend: an edge has the mean of its ends, an angle that of the particle where its
    /// edges meet. `None` for 1.
    pub stiffness: Option<Map>,
    /// The angles by which it turns at rest; `None` for a flat sheet.
    pub rest_angles: Option<RestAngles>,
    /// Gravity as an acceleration [edges / frame^2]
    /// ([`Setup::acceleration_of`](crate::scene::Setup::acceleration_of)).
    pub gravity: [f64; 3],
    /// Air around it; zero for none.
    pub air: Air,
    /// Repulsion between its layers, the cheaper and looser way to keep them apart.
    pub repulsion: Option<Repulsion>,
    /// Contact with itself; `None` for a cloth that passes through itself.
    pub self_contact: Option<SelfContact>,
    /// Particle numbers of the handles, without duplicates.
    pub handles: Vec<usize>,
    /// Bodies that it meets, [`MAX_BODIES`] at most.
    pub bodies: Vec<Body>,
    /// Which particles of the grid it has; `None` for all.
    pub mask: Option<Mask>,
}

impl Cloth {
    /// Whether it has particle `p` of the grid.
    pub fn contains(&self, p: usize) -> bool {
        self.mask.as_ref().is_none_or(|mask| mask.contains(p))
    }

    /// Returns the number of its edges along the axes of its grid.
    pub fn edges(&self, grid: Grid) -> usize {
        let Grid { h, w } = grid;
        let Some(mask) = &self.mask else { return (h - 1) * w + h * (w - 1) };
        let inside = |p: usize| mask.contains(p);
        let joined = |p: usize, q: usize| usize::from(inside(p) && inside(q));
        let down = (0..(h - 1) * w).map(|p| joined(p, p + w)).sum::<usize>();
        let right = (0..h * w).filter(|p| p % w + 1 < w).map(|p| joined(p, p + 1)).sum::<usize>();
        down + right
    }

    /// Returns its triangles on its grid, see [`Grid::faces`].
    pub fn faces(&self, grid: Grid) -> Vec<[u32; 3]> {
        self.mask.as_ref().map_or_else(|| grid.faces(), Mask::faces)
    }

    /// Returns the particles of the grid that no acceleration moves: its handles, and those that it doesn't have.
    pub(crate) fn held(&self) -> Vec<usize> {
        let outside =
            self.mask.iter().flat_map(|mask| (0..mask.grid().particles()).filter(|&p| !mask.contains(p)));
        self.handles.iter().copied().chain(outside).collect()
    }

    /// Returns about how much curvature its contacts add to the energy along a particle's displacement, for each unit of
    /// its mass: that of barrier and friction under the particle's own weight, on the body or layer where it is most; 0 without
    /// any. Optimizers take it into their Hessian of the sheet at rest.
    ///
    /// With the gravity G, a particle at rest has the gap `g = h - g sqrt(G h / 2)`, where the barrier's second derivative is
    /// `4 / g^2 sqrt(G h / 2)` with g near h, and friction has at most `mu G / eps`
    /// ([`Contact`](super::terms::Contact)). Between layers a particle has its share of that ([`SelfContact::SHARE`]).
    pub(crate) fn contact_curvature(&self) -> f64 {
        let weight = self.gravity.iter().map(|g| g * g).sum::<f64>().sqrt();
        let of_contact = |h: f64, friction: f64| {
            4.0 / (h * h) * (0.5 * weight * h).sqrt() + friction * weight / Contact::STICKING
        };
        let present = self.bodies.iter().filter(|body| body.present);
        let of_bodies = present.map(|body| of_contact(body.thickness, body.friction));
        let of_layers = |own: SelfContact| SelfContact::SHARE * of_contact(own.thickness, own.friction);
        of_bodies.chain(self.self_contact.map(of_layers)).fold(0.0, f64::max)
    }
}

/// A batch of independent cloths on one grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// The grid, which all cloths share.
    pub grid: Grid,
    /// The cloths, B of them.
    pub cloths: Vec<Cloth>,
}

impl Model {
    /// Returns the number of cloths (B).
    pub fn batch(&self) -> usize {
        self.cloths.len()
    }

    /// Fails if the grid is too small or too large ([`Grid::new`]), there is no cloth, a handle is outside
    /// the grid, not part of its cloth or listed twice, a mask, a map or rest angles are of another grid, a number of a repulsion is out of the range given in [`Repulsion`], a
    /// coefficient is negative, or any number is not finite in single precision.
    pub fn check(&self) -> Result<()> {
        Grid::new(self.grid.h, self.grid.w, "model")?;
        let n = self.grid.particles();
        if self.cloths.is_empty() {
            return Err(Error::invalid("model", "cloths", "at least one", 0));
        }
        for (b, cloth) in self.cloths.iter().enumerate() {
            let Cloth { material, air, gravity, damping, .. } = *cloth;
            let ([stretch_down, stretch_across], [bend_down, bend_across]) =
                (material.stretches(), material.bends());
            let coefficients = [
                ("stretch", material.stretch),
                ("shear", material.shear),
                ("bend", material.bend),
                ("stretch along the height", stretch_down),
                ("stretch along the width", stretch_across),
                ("bend along the height", bend_down),
                ("bend along the width", bend_across),
                ("damping", damping),
                ("air density", air.density),
                ("air drag", air.drag),
            ];
            let refused = |what: &str, expected: &str, found: f64| {
                Err(Error::invalid("model", format!("{what} of cloth {b}"), expected, found))
            };
            // Checked as the device stores them: the value may overflow single precision.
            if let Some(&(what, k)) =
                coefficients.iter().find(|(_, k)| !(*k >= 0.0 && (*k as f32).is_finite()))
            {
                return refused(what, "a finite number, 0 or greater", k);
            }
            if let Some(&g) = gravity.iter().find(|g| !(**g as f32).is_finite()) {
                return refused("gravity", "finite numbers", g);
            }
            if let Some(repulsion) = cloth.repulsion {
                repulsion.check("model", &format!("repulsion of cloth {b}"))?;
            }
            if let Some(self_contact) = cloth.self_contact {
                self_contact.check("model", &format!("self-contact of cloth {b}"))?;
            }
            if cloth.bodies.len() > MAX_BODIES {
                let expected = format!("{MAX_BODIES} at most");
                return Err(Error::invalid(
                    "model",
                    format!("bodies of cloth {b}"),
                    expected,
                    cloth.bodies.len(),
                ));
            }
            for (k, body) in cloth.bodies.iter().enumerate() {
                body.check("model", &format!("body {k} of cloth {b}"))?;
            }
            let refused = |expected: String, p: usize| {
                Err(Error::invalid("model", format!("handles of cloth {b}"), expected, p))
            };
            let grids = [
                ("mask", cloth.mask.as_ref().map(Mask::grid)),
                ("density", cloth.density.as_ref().map(Map::grid)),
                ("stiffness", cloth.stiffness.as_ref().map(Map::grid)),
                ("rest angles", cloth.rest_angles.as_ref().map(RestAngles::grid)),
            ];
            for (what, grid) in grids {
                if let Some(grid) = grid.filter(|&grid| grid != self.grid) {
                    let expected = format!("one of a grid of {}", self.grid);
                    return Err(Error::invalid("model", format!("{what} of cloth {b}"), expected, grid));
                }
            }
            let mut seen = HashSet::new();
            for &p in &cloth.handles {
                if p >= n {
                    return refused(format!("particles 0 to {} of a grid of {}", n - 1, self.grid), p);
                }
                if let Some(mask) = cloth.mask.as_ref().filter(|mask| !mask.contains(p)) {
                    return refused(format!("particles of the cloth, such as {}", mask.nearest(p)), p);
                }
                if !seen.insert(p) {
                    return refused("no particle more than once".into(), p);
                }
            }
        }
        Ok(())
    }

    /// Returns the model with these cloths instead. Fails if their number differs, or if they are not valid
    /// ([`Model::check`]).
    pub(crate) fn with_cloths(&self, cloths: &[Cloth]) -> Result<Self> {
        let model = Self { grid: self.grid, cloths: cloths.to_vec() };
        model.check()?;
        match model.batch() == self.batch() {
            true => Ok(model),
            false => {
                let expected = format!("{}, the number that the solver was built for", self.batch());
                Err(Error::invalid("model", "cloths", expected, model.batch()))
            }
        }
    }

    /// Whether any cloth has a repulsion.
    pub fn repels(&self) -> bool {
        self.cloths.iter().any(|cloth| cloth.repulsion.is_some())
    }

    /// Whether any cloth touches itself.
    pub fn touches_itself(&self) -> bool {
        self.cloths.iter().any(|cloth| cloth.self_contact.is_some())
    }

    /// Fails, naming the cloth, if one touches itself. `why` completes "expected none, ".
    pub(crate) fn refuse_self_contact(&self, why: &str) -> Result<()> {
        let Some(b) = self.cloths.iter().position(|cloth| cloth.self_contact.is_some()) else {
            return Ok(());
        };
        Err(Error::invalid("model", format!("self-contact of cloth {b}"), format!("none, {why}"), "one"))
    }

    /// Fails, naming the cloth, if one has angles at rest. `why` completes "expected none, ".
    pub(crate) fn refuse_rest_angles(&self, why: &str) -> Result<()> {
        let Some(b) = self.cloths.iter().position(|cloth| cloth.rest_angles.is_some()) else {
            return Ok(());
        };
        Err(Error::invalid("model", format!("rest angles of cloth {b}"), format!("none, {why}"), "some"))
    }

    /// Fails, naming the cloth, if one has a repulsion. `why` completes "expected none, ".
    pub(crate) fn refuse_repulsion(&self, why: &str) -> Result<()> {
        let Some(b) = self.cloths.iter().position(|cloth| cloth.repulsion.is_some()) else { return Ok(()) };
        Err(Error::invalid("model", format!("repulsion of cloth {b}"), format!("none, {why}"), "one"))
    }

    /// Returns the number of bodies of all cloths together.
    pub fn bodies(&self) -> usize {
        self.cloths.iter().map(|c| c.bodies.len()).sum()
    }

    /// Returns the places of cloth `b` in [`Control::bodies`]. Panics if there is no cloth `b`.
    pub fn body_range(&self, b: usize) -> Range<usize> {
        let before: usize = self.cloths[..b].iter().map(|cloth| cloth.bodies.len()).sum();
        before..before + self.cloths[b].bodies.len()
    }

    /// Returns the number of handles of all cloths together.
    pub fn handles(&self) -> usize {
        self.cloths.iter().map(|c| c.handles.len()).sum()
    }

    /// Returns the places of cloth `b` in [`Control::handles`]. Panics if there is no cloth `b`.
    pub fn handle_range(&self, b: usize) -> Range<usize> {
        let before: usize = self.cloths[..b].iter().map(|cloth| cloth.handles.len()).sum();
        before..before + self.cloths[b].handles.len()
    }

    /// Whether any cloth has angles at rest.
    pub fn has_rest_angles(&self) -> bool {
        self.cloths.iter().any(|cloth| cloth.rest_angles.is_some())
    }

    /// Whether all cloths are full rectangles.
    pub fn is_full(&self) -> bool {
        self.cloths.iter().all(|cloth| cloth.mask.is_none())
    }

    /// Returns what each particle is, shape [B, H, W]. Panics if a handle is outside the grid ([`Model::check`]).
    pub fn marks(&self) -> Vec<Mark> {
        let of_cloth =
            |(b, cloth): (usize, &Cloth)| Mark::of_cloth(self.grid, cloth, self.handle_range(b).start);
        self.cloths.iter().enumerate().flat_map(of_cloth).collect()
    }
}

/// Positions \[edges\] and velocities [edges / frame] of a batch, each of shape [B, 3, H, W].
#[derive(Clone, Debug, PartialEq)]
pub struct State<T> {
    /// Positions, shape [B, 3, H, W].
    pub x: Vec<T>,
    /// Velocities, shape [B, 3, H, W].
    pub v: Vec<T>,
}

/// Converts a number to another precision.
pub(crate) fn cast<T: Float, U: Float>(v: T) -> U {
    U::from(v).expect("a float casts to a float")
}

impl<T: Float> State<T> {
    /// Returns the rest state of `batch` cloths: particle (i, j) at `(j, i - (H-1)/2, 0)`, velocity 0.
    pub fn rest(grid: Grid, batch: usize) -> Self {
        let n = grid.particles();
        let mut x = vec![T::zero(); batch * 3 * n];
        for cloth in x.chunks_mut(3 * n) {
            for p in 0..n {
                [cloth[p], cloth[n + p], cloth[2 * n + p]] = grid.rest(p).map(cast);
            }
        }
        let v = vec![T::zero(); x.len()];
        Self { x, v }
    }

    /// Returns the state in another precision.
    pub fn cast<U: Float>(&self) -> State<U> {
        let all = |s: &[T]| s.iter().map(|&a| cast(a)).collect();
        State { x: all(&self.x), v: all(&self.v) }
    }
}

impl<T: Float> Control<T> {
    /// Fails unless the control has a position for each handle of the model, wind and accelerations for all of its
    /// cloths or for none, and valid sweeps of all of its bodies or of none. Solvers panic in such a case.
    pub fn check(&self, model: &Model) -> Result<()> {
        let batch = model.batch();
        let fits = |field: &str, found: usize, allowed: [usize; 2]| match allowed.contains(&found) {
            true => Ok(()),
            false => {
                let expected = match allowed {
                    [least, all] if least == all => all.to_string(),
                    [_, all] => format!("{all}, or none"),
                };
                Err(Error::invalid("control", field, expected, found))
            }
        };
        fits("handles", self.handles.len(), [model.handles(); 2])?;
        fits("wind", self.wind.len(), [0, batch])?;
        fits("external", self.external.len(), [0, 3 * batch * model.grid.particles()])?;
        fits("bodies", self.bodies.len(), [0, model.bodies()])?;
        self.bodies.iter().enumerate().try_for_each(|(k, sweep)| sweep.check(&format!("bodies[{k}]")))
    }

    /// Returns the control in another precision.
    pub fn cast<U: Float>(&self) -> Control<U> {
        let points = |points: &[[T; 3]]| points.iter().map(|p| p.map(cast)).collect();
        let external = self.external.iter().map(|&f| cast(f)).collect();
        let bodies = self.bodies.clone();
        Control { handles: points(&self.handles), wind: points(&self.wind), external, bodies }
    }
}

/// The inputs of one frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Control<T> {
    /// Handle positions at the end of the frame \[edges\]: all handles of cloth 0, then of cloth 1, and so
    /// on.
    pub handles: Vec<[T; 3]>,
    /// Wind velocity of each cloth [edges / frame], shape `[B]`; empty for still air.
    pub wind: Vec<[T; 3]>,
    /// External acceleration of each particle [edges / frame^2], in addition to gravity and air, shape
    /// [B, 3, H, W]; empty for none. Divide a force by the particle's mass;
    /// [`Setup::acceleration_of`](crate::scene::Setup::acceleration_of) converts.
    pub external: Vec<T>,
    /// How the bodies move in the frame: all bodies of cloth 0, then of cloth 1, and so on; empty for bodies that
    /// stay where the model has them.
    pub bodies: Vec<Sweep>,
}

impl<T> Control<T> {
    /// Returns how body `k` of cloth `b` moves in the frame. Panics if there is no such body.
    pub fn sweep(&self, model: &Model, b: usize, k: usize) -> Sweep {
        let stays = || Sweep::still(model.cloths[b].bodies[k].pose);
        if self.bodies.is_empty() { stays() } else { self.bodies[model.body_range(b).start + k] }
    }
}
