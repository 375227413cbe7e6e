//! The inverse Hessian of a sheet that is not flat, and the steps that it takes.

use super::passes::Pass;
use super::rest_hessian::{Cosines, Scratch, hold};
use crate::cloth::Cloth;
use crate::cloth::modes::{Component, Reactions, SheetConstants};
use crate::cpu::Real;
use rayon::prelude::*;
use std::sync::Arc;

/// The inverse Hessian of a sheet that is not flat, approximately, in the axes of the world and in the sheet's own
/// ([`SheetAxes`](crate::cpu::cloth::SheetAxes)). Neither serves alone: along its surface a sheet is a thousand times as stiff as across it, and its inertia is
/// the same in all directions, however it is bent.
///
/// In space it is `P S C^T diag(1 / lambda) C S P`, as in [`RestHessian`](super::RestHessian) but for S, which multiplies each particle by its factor,
/// and for a larger inertia in lambda. In the sheet it is `P A C^T diag(1 / lambda) C A^T P`, where the columns of A are the axes of
/// each particle, and lambda differs from one to the next.
pub struct SheetHessian<T> {
    cosines: Arc<Cosines<T>>,
    /// 1 / lambda of each [`Component`], shape [H, stride].
    inverses: [Vec<T>; 4],
    held: Vec<usize>,
    scratch: Scratch<T>,
}

/// The steps by the inverse Hessian of a sheet whose handles hold ([`Reactions`]).
///
/// A step across a curved surface stretches it, unless the surface moves along itself at the same time: a fold travels, and a bulge
/// draws in what is around it. What a sheet is slowest to do by itself is this, since neither part of the step is possible alone.
/// So the step in the sheet is taken first across it, and then along it by the forces that are left.
pub struct SheetSteps<T> {
    hessian: SheetHessian<T>,
    handles: Vec<usize>,
    /// Shape [K, 4, H W].
    reactions: Vec<T>,
    /// The forces that a step leaves, shape [3, H, W].
    rest: Vec<T>,
    /// Two components of a step, shape [2, H, W].
    parts: Vec<T>,
}

/// What [`SheetAxes`](crate::cpu::cloth::SheetAxes) says of each particle, shape [n] each.
struct Axes<'a, T> {
    /// The components of t_1, t_2 and n.
    axes: [[&'a [T]; 3]; 3],
    near: &'a [T],
    /// The components of the edges down and to the right.
    edges: [[&'a [T]; 3]; 2],
}

impl<'a, T> Axes<'a, T> {
    fn new(axes: &'a [T], n: usize) -> Self {
        let of = |c: usize| &axes[c * n..][..n];
        let vector = |first: usize| std::array::from_fn(|c| of(first + c));
        Self { axes: [0, 3, 6].map(vector), near: of(9), edges: [10, 13].map(vector) }
    }
}

impl<T: Real> SheetHessian<T> {
    /// Builds the inverse Hessian of one cloth with the tables of its grid.
    pub fn new(cosines: &Arc<Cosines<T>>, cloth: &Cloth, constants: &SheetConstants) -> Self {
        Self {
            inverses: Component::ALL.map(|component| cosines.inverses(component, (cloth, constants))),
            held: cloth.held(),
            scratch: cosines.scratch(),
            cosines: cosines.clone(),
        }
    }

    /// Multiplies `direction` [3, H, W] by the inverse Hessian in the sheet, given its `axes` [16, H, W]. The result is 0 at
    /// handles.
    pub fn apply_in_sheet(&mut self, axes: &[T], direction: &mut [T]) {
        let Self { cosines, inverses, held, scratch } = self;
        let n = cosines.grid().particles();
        let axes = Axes::new(axes, n);
        hold(held, direction);
        let (x, rest) = direction.split_at_mut(n);
        let (y, z) = rest.split_at_mut(n);
        let a = &axes.axes;
        for p in 0..n {
            let v = [x[p], y[p], z[p]];
            [x[p], y[p], z[p]] = a.map(|axis| axis[0][p] * v[0] + axis[1][p] * v[1] + axis[2][p] * v[2]);
        }
        let components = [x, y, z].into_par_iter().zip(scratch).zip(&inverses[1..]);
        components.for_each(|((component, scratch), inverse)| cosines.apply(component, inverse, scratch));
        let (x, rest) = direction.split_at_mut(n);
        let (y, z) = rest.split_at_mut(n);
        for p in 0..n {
            let v = [x[p], y[p], z[p]];
            let of = |c: usize| a[0][c][p] * v[0] + a[1][c][p] * v[1] + a[2][c][p] * v[2];
            [x[p], y[p], z[p]] = [of(0), of(1), of(2)];
        }
        hold(held, direction);
    }
}

impl<T: Real> SheetSteps<T> {
    /// Builds the steps of one cloth with the tables of its grid.
    pub fn new(cosines: &Arc<Cosines<T>>, cloth: &Cloth, constants: &SheetConstants) -> Self {
        let Reactions { handles, fields } = Reactions::new(cosines.grid(), cloth, constants);
        let hessian = SheetHessian::new(cosines, cloth, constants);
        let reactions = fields.into_iter().map(T::of).collect();
        let zeros = |fields: usize| vec![T::zero(); fields * cosines.grid().particles()];
        Self { hessian, handles, reactions, rest: zeros(3), parts: zeros(2) }
    }

    /// Turns the forces `direction` [3, H, W] into the step in the axes of the world, given the `axes` [16, H, W] of the sheet.
    /// The result is 0 at handles.
    pub fn in_space(&mut self, axes: &[T], direction: &mut [T]) {
        let Self { hessian: SheetHessian { cosines, inverses, held, scratch }, handles, reactions, .. } =
            self;
        let n = cosines.grid().particles();
        let near = Axes::new(axes, n).near;
        hold(held, direction);
        direction.par_chunks_exact_mut(n).zip(scratch).for_each(|(component, scratch)| {
            Pass::Multiply(component, near).run();
            cosines.apply(component, &inverses[Component::Space as usize], scratch);
            react((handles, reactions), Component::Space, component);
            Pass::Multiply(component, near).run();
        });
        hold(held, direction);
    }

    /// Turns the forces `direction` [3, H, W] into the step across the sheet's surface and the answer along it, given its `axes`
    /// [16, H, W]. The result is 0 at handles.
    pub fn in_sheet(&mut self, axes: &[T], direction: &mut [T]) {
        let Self { hessian, handles, reactions, rest, parts } = self;
        let SheetHessian { cosines, inverses, held, scratch } = hessian;
        let reactions = (&handles[..], &reactions[..]);
        let (w, n) = (cosines.grid().w, cosines.grid().particles());
        let Axes { axes, edges, .. } = Axes::new(axes, n);
        let (one, other) = parts.split_at_mut(n);
        hold(held, direction);
        rest.copy_from_slice(direction);
        // Across.
        Pass::Project(one, axes[2], rest).run();
        cosines.apply(one, &inverses[Component::Normal as usize], &mut scratch[0]);
        react(reactions, Component::Normal, one);
        Pass::Along(direction, axes[2], one).run();
        hold(held, direction);
        // What the stretch answers.
        for (edges, next) in edges.into_iter().zip([w, 1]) {
            Pass::Answer { forces: rest, edges, next, step: direction, memory: one }.run();
        }
        hold(held, rest);
        // Along.
        Pass::Project(one, axes[0], rest).run();
        Pass::Project(other, axes[1], rest).run();
        let tangents = [Component::FirstTangent, Component::SecondTangent];
        [&mut *one, &mut *other].into_par_iter().zip(tangents).zip(&mut scratch[..2]).for_each(
            |((field, component), scratch)| {
                cosines.apply(field, &inverses[component as usize], scratch);
                react(reactions, component, field);
            },
        );
        Pass::AddAlong(direction, axes[0], one).run();
        Pass::AddAlong(direction, axes[1], other).run();
        hold(held, direction);
    }
}

/// Takes back what a step [n] of a component does at the handles.
fn react<T: Real>((handles, reactions): (&[usize], &[T]), component: Component, step: &mut [T]) {
    let n = step.len();
    for (k, &handle) in handles.iter().enumerate() {
        // The fields of other handles are 0 here.
        let moved = step[handle];
        let field = &reactions[(4 * k + component as usize) * n..][..n];
        Pass::Add(step, -moved, field).run();
    }
}
