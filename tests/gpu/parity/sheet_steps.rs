//! The transforms and steps of a sheet together (`cosine_rows`, `cosine_columns`, `answer_rows` and `sheet_steps`)
//! against the CPU path in double precision, and against dense sums.

use super::cloth::{constants, field, iterate, model};
use crate::common::{assert_close, cases, context, device, largest, noise, poisoned, read, run, tensor};
use fnopt::cloth::modes::{Component, Reactions, SheetConstants};
use fnopt::cloth::{Body, Cloth, Grid, Model, Pose, Shape};
use fnopt::cpu::optim::{Cosines, SheetSteps as ExactSteps};
use fnopt::kernels::cloth::sheet_axes::AXES;
use fnopt::kernels::optim::cosine_columns::squared_frequencies;
use fnopt::kernels::optim::cosine_rows::table;
use fnopt::kernels::optim::{
    AnswerRows, CosineColumns, CosineRows, Fields, Reacting, SheetSteps, directions,
};
use std::f64::consts::PI;
use std::sync::Arc;

/// Returns the orthonormal DCT-II of n points, row by row.
fn cosines(n: usize) -> Vec<f64> {
    let of = |k: usize, i: usize| {
        let scale = if k == 0 { 1.0 } else { 2.0 };
        (scale / n as f64).sqrt() * (PI * k as f64 * (2 * i + 1) as f64 / (2 * n) as f64).cos()
    };
    (0..n * n).map(|at| of(at / n, at % n)).collect()
}

/// Returns the product of matrices [rows, depth] and [depth, columns].
fn product(a: &[f64], b: &[f64], (depth, columns): (usize, usize)) -> Vec<f64> {
    let row = |a: &[f64]| {
        let mut row = vec![0.0; columns];
        for (&a, b) in a.iter().zip(b.chunks_exact(columns)) {
            row.iter_mut().zip(b).for_each(|(to, &b)| *to += a * b);
        }
        row
    };
    a.chunks_exact(depth).flat_map(row).collect()
}

fn transposed(a: &[f64], columns: usize) -> Vec<f64> {
    (0..columns).flat_map(|c| a[c..].iter().step_by(columns).copied()).collect()
}

/// Multiplies a field by the inverse Hessian of a component, in cosine space.
fn inverse(grid: Grid, model: &Model, b: usize, component: Component, values: &[f64]) -> Vec<f64> {
    let Grid { h, w } = grid;
    let of = (&model.cloths[b], &SheetConstants::FITTED);
    let (along, across) = (cosines(h), cosines(w));
    let z = product(&along, &product(values, &transposed(&across, w), (w, w)), (h, w));
    let divided = z.iter().enumerate().map(|(at, z)| z / component.eigenvalue(grid, of, (at / w, at % w)));
    product(&transposed(&along, h), &product(&divided.collect::<Vec<_>>(), &across, (w, w)), (h, w))
}

/// Returns the fields of a cloth whose transform is taken, given the forces [3, n] and its axes [16, n].
fn fields_of(fields: Fields, marks: &[bool], forces: &[f32], axes: &[f32]) -> Vec<Vec<f64>> {
    let n = marks.len();
    let weights = |field: usize, p: usize| {
        let at = |c: usize| f64::from(axes[c * n + p]);
        match (fields, field) {
            (Fields::SpaceAndNormal, 3) => [0, 1, 2].map(|c| at(6 + c)),
            (Fields::SpaceAndNormal, _) => [0, 1, 2].map(|c| if c == field { at(9) } else { 0.0 }),
            (Fields::Tangents, _) => [0, 1, 2].map(|c| at(3 * field + c)),
        }
    };
    let value = |field: usize, p: usize| {
        (0..3).map(|c| weights(field, p)[c] * f64::from(forces[c * n + p])).sum::<f64>()
    };
    let of = |field: usize| (0..n).map(|p| if marks[p] { value(field, p) } else { 0.0 }).collect();
    (0..fields.count()).map(of).collect()
}

/// Sides of all parities, shorter and longer than the tiles.
fn grids() -> impl Iterator<Item = (Grid, usize)> {
    cases().chain([(9, 31), (150, 8), (33, 65), (10, 131)].map(|(h, w)| (Grid { h, w }, 2)))
}

/// What the transforms of a batch need.
struct Given {
    model: Model,
    grad: Vec<f32>,
    axes: Vec<f32>,
}

impl Given {
    /// Three vectors, a factor and two edges for each particle, whatever they are.
    fn new(grid: Grid, batch: usize) -> Self {
        let mut model = model(grid, batch);
        // The first cloth's contacts count in its modes, wherever the body is.
        let pose = Pose { position: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] };
        let body = Body { shape: Shape::Plane, pose, thickness: 0.2, friction: 0.4, present: true };
        model.cloths[0].bodies = vec![body];
        let grad = field(&model, 1.0, 122);
        Self { grad, axes: noise(AXES * batch * grid.particles(), 131), model }
    }

    fn free(&self, b: usize) -> Vec<bool> {
        let n = self.model.grid.particles();
        self.model.marks()[b * n..][..n].iter().map(|mark| mark.is_free()).collect()
    }
}

/// Returns the values at free particles, and 0 elsewhere.
fn masked(values: &[f64], free: &[bool]) -> Vec<f64> {
    values.iter().zip(free).map(|(&value, &free)| if free { value } else { 0.0 }).collect()
}

#[test]
fn transforms_match_dense_sums() {
    let _turn = device();
    for (fields, staged) in [Fields::SpaceAndNormal, Fields::Tangents]
        .into_iter()
        .flat_map(|fields| [(fields, false), (fields, true)])
    {
        let rows = CosineRows::new(context(), staged).unwrap();
        let sheet_steps = SheetSteps::new(context(), staged).unwrap();
        let components = match fields {
            Fields::SpaceAndNormal => {
                &[Component::Space, Component::Space, Component::Space, Component::Normal][..]
            }
            Fields::Tangents => &[Component::FirstTangent, Component::SecondTangent],
        };
        for (grid, batch) in grids() {
            let columns = CosineColumns::new(context(), fields, grid, staged).unwrap();
            let answer_rows = AnswerRows::new(context(), grid, staged).unwrap();
            let given = Given::new(grid, batch);
            let n = grid.particles();
            let iterate = iterate(&given.model);
            iterate.grad.write(context(), &given.grad);
            let axes = tensor("axes", &[batch, AXES, n], &given.axes);
            let [along_column, along_row] = [grid.h, grid.w].map(|n| table(context(), n).unwrap());
            let (mu, cloths) = (squared_frequencies(context(), grid).unwrap(), constants(&given.model));
            let [z, y] = ["z", "y"].map(|label| poisoned(label, &Fields::shape(batch, grid)));
            let values: Vec<Vec<f64>> = (0..batch)
                .flat_map(|b| {
                    let own = (&given.grad[3 * b * n..][..3 * n], &given.axes[AXES * b * n..][..AXES * n]);
                    fields_of(fields, &given.free(b), own.0, own.1)
                })
                .collect();
            let transposed = transposed(&cosines(grid.w), grid.w);
            let of_rows: Vec<f64> =
                values.iter().flat_map(|values| product(values, &transposed, (grid.w, grid.w))).collect();
            // What the other fields are does not matter.
            let mut given_modes = vec![f32::NAN; z.len()];
            let own = fields.first() * n..(fields.first() + fields.count()) * n;
            for (to, of_rows) in given_modes.chunks_exact_mut(6 * n).zip(of_rows.chunks_exact(own.len())) {
                to[own.clone()].iter_mut().zip(of_rows).for_each(|(to, &v)| *to = v as f32);
            }
            if fields == Fields::SpaceAndNormal {
                run(|schedule| rows.push(schedule, grid, (&iterate, &axes), [&along_row, &z]));
                let found: Vec<f32> =
                    read(&z).chunks_exact(6 * n).flat_map(|all| all[own.clone()].to_vec()).collect();
                let what = format!("rows of {batch} x {grid}");
                assert_close(&what, &found, &of_rows, (3e-6 * largest(&of_rows), 0.0));
            }
            z.write(context(), &given_modes);
            // No handle reacts. Of the tangents only steps are written, so these are the first two axes of the world, and the normal is 0.
            let reacting = Reacting::new(context(), 1, (grid, batch)).unwrap();
            let all = poisoned("directions", &directions::shape(3, batch, grid));
            let axis = |k: usize| f32::from(u8::from([0, 4].contains(&(k / n % AXES))));
            let plain: Vec<f32> = (0..AXES * batch * n).map(axis).collect();
            let plain = tensor("axes", &[batch, AXES, n], &plain);
            if fields == Fields::Tangents {
                y.write(context(), &noise(y.len(), 133));
            }
            run(|schedule| {
                columns.push(schedule, (&cloths, &along_column, &mu), [&z, &y]);
                let of_sheet = (&iterate, &plain, &reacting);
                match fields {
                    Fields::SpaceAndNormal => {
                        answer_rows.push(schedule, grid, of_sheet, [&along_row, &z, &y]);
                    }
                    Fields::Tangents => {
                        sheet_steps.push(schedule, grid, of_sheet, [&along_row, &z, &y, &all]);
                    }
                }
            });
            let found = match fields {
                Fields::SpaceAndNormal => read(&y),
                Fields::Tangents => read(&directions::one(&all, directions::ROTATED, batch, grid)),
            };
            for (field, of_cloth) in values
                .chunks_exact(fields.count())
                .enumerate()
                .flat_map(|(b, all)| all.iter().zip(components).enumerate().map(move |(f, of)| ((b, f), of)))
            {
                let ((b, f), (values, &component)) = (field, of_cloth);
                let exact = inverse(grid, &given.model, b, component, values);
                let (found, exact) = match fields {
                    Fields::SpaceAndNormal => (found[(6 * b + f) * n..][..n].to_vec(), exact),
                    Fields::Tangents => {
                        let found = &found[(3 * b + f) * n..][..n];
                        let free = given.free(b);
                        assert!(free.iter().zip(found).all(|(&free, &step)| free || step == 0.0));
                        (found.iter().map(|step| -step).collect(), masked(&exact, &free))
                    }
                };
                // Low modes are much larger than the others, so that every element has their rounding.
                let what = format!("{component:?} of cloth {b} of {batch} x {grid}");
                assert_close(&what, &found, &exact, (3e-6 * largest(&exact), 0.0));
            }
        }
    }
}

#[test]
fn steps_match() {
    let _turn = device();
    for (grid, batch, staged) in grids().flat_map(|(grid, batch)| [(grid, batch, false), (grid, batch, true)])
    {
        let rows = CosineRows::new(context(), staged).unwrap();
        let columns = [Fields::SpaceAndNormal, Fields::Tangents]
            .map(|fields| CosineColumns::new(context(), fields, grid, staged).unwrap());
        let answer_rows = AnswerRows::new(context(), grid, staged).unwrap();
        let sheet_steps = SheetSteps::new(context(), staged).unwrap();
        let given = Given::new(grid, batch);
        let (model, n) = (&given.model, grid.particles());
        let iterate = iterate(model);
        iterate.grad.write(context(), &given.grad);
        let axes = tensor("axes", &[batch, AXES, n], &given.axes);
        let [along_column, along_row] = [grid.h, grid.w].map(|n| table(context(), n).unwrap());
        let (mu, cloths) = (squared_frequencies(context(), grid).unwrap(), constants(model));
        let room = Reactions::most(model);
        let reacting = Reacting::new(context(), room, (grid, batch)).unwrap();
        reacting.write(context(), model);
        let all = poisoned("directions", &directions::shape(3, batch, grid));
        let [z, y] = ["z", "y"].map(|label| poisoned(label, &Fields::shape(batch, grid)));
        let of_columns = (&cloths, &along_column, &mu);
        let of_sheet = (&iterate, &axes, &reacting);
        run(|schedule| {
            rows.push(schedule, grid, (&iterate, &axes), [&along_row, &z]);
            columns[0].push(schedule, of_columns, [&z, &y]);
            answer_rows.push(schedule, grid, of_sheet, [&along_row, &z, &y]);
            columns[1].push(schedule, of_columns, [&z, &y]);
            sheet_steps.push(schedule, grid, of_sheet, [&along_row, &z, &y, &all]);
        });
        let (mut spectral, mut rotated) = (vec![], vec![]);
        let mut unheld = [0.0_f64; 2];
        let cosines = Arc::new(Cosines::<f64>::new(grid));
        for (b, cloth) in model.cloths.iter().enumerate() {
            let of = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
            let axes = of(&given.axes[AXES * b * n..][..AXES * n]);
            // An edge past the border is none.
            let axes: Vec<f64> = axes
                .iter()
                .enumerate()
                .map(|(k, &v)| match (k / n, k % n) {
                    (10..13, p) if p / grid.w == grid.h - 1 => 0.0,
                    (13..16, p) if p % grid.w == grid.w - 1 => 0.0,
                    _ => v,
                })
                .collect();
            let forces: Vec<f64> = of(&given.grad[3 * b * n..][..3 * n]).iter().map(|g| -g).collect();
            let mut steps = ExactSteps::new(&cosines, cloth, &SheetConstants::FITTED);
            let both = |steps: &mut ExactSteps<f64>| {
                let (mut in_space, mut in_sheet) = (forces.clone(), forces.clone());
                steps.in_space(&axes, &mut in_space);
                steps.in_sheet(&axes, &mut in_sheet);
                [in_space, in_sheet]
            };
            let [in_space, in_sheet] = both(&mut steps);
            spectral.extend(in_space);
            rotated.extend(in_sheet);
            let free = Cloth { handles: vec![], ..cloth.clone() };
            let mut alone = ExactSteps::new(&cosines, &free, &SheetConstants::FITTED);
            for (most, step) in unheld.iter_mut().zip(both(&mut alone)) {
                *most = most.max(largest(&step));
            }
        }
        for (slot, exact) in [(directions::SPECTRAL, spectral), (directions::ROTATED, rotated)] {
            let found = read(&directions::one(&all, slot, batch, grid));
            // Low modes are much larger than the others, so that every element has their rounding, also where handles take them back.
            let scale = largest(&exact).max(unheld[slot]);
            let what = format!("direction {slot} of {batch} x {grid}, staged: {staged}");
            assert_close(&what, &found, &exact, (5e-6 * scale, 0.0));
        }
        let last = read(&directions::one(&all, directions::LAST_STEP, batch, grid));
        assert!(last.iter().all(|v| v.is_nan()), "the last step is not written");
    }
}
