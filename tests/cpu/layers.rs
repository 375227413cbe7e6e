//! Contact of a cloth with itself.

use crate::cloths::jagged;
use crate::noise::noise;
use fnopt::cloth::terms::Contact;
use fnopt::cloth::{Cloth, Control, Grid, Mask, Material, Model, Parts, SelfContact, State, intersections};
use fnopt::cpu::cloth::{Approach, CurvatureRows, Layers};
use fnopt::cpu::{Objective, Solver};
use fnopt::scene::{Scene, Script, SelfContactSettings};
use fnopt::settings::PARTING_ROUNDS;
use fnopt::sim::Optimizer;
use fnopt::{Device, Simulator};
use glam::DVec3;
use std::collections::BTreeSet;
use std::path::Path;

const SETTINGS: SelfContact = SelfContact { thickness: 0.16, friction: 0.4 };

/// Returns a field [3, n] of places.
fn field(places: impl Fn(usize, usize) -> DVec3, grid: Grid) -> Vec<f64> {
    let all: Vec<DVec3> = (0..grid.particles()).map(|p| places(p / grid.w, p % grid.w)).collect();
    (0..3).flat_map(|c| all.iter().map(move |place| place[c])).collect()
}

/// Returns the field with noise of this size.
fn shaken(mut field: Vec<f64>, size: f64, seed: u64) -> Vec<f64> {
    let noise = noise(field.len(), seed);
    field.iter_mut().zip(noise).for_each(|(x, noise)| *x += size * noise);
    field
}

/// A sheet folded in the middle, whose halves are this far apart, the upper one shifted by part of an edge.
fn folded(grid: Grid, apart: f64) -> Vec<f64> {
    let middle = (grid.w / 2) as f64;
    let place = |i: usize, j: usize| {
        let beyond = j as f64 - middle;
        let upper = f64::from(u8::from(beyond > 0.0));
        DVec3::new(middle - beyond.abs() + 0.3 * upper, i as f64 + 0.4 * upper, apart * upper)
    };
    field(place, grid)
}

/// A sheet rolled up, its turns about 0.3 edges apart.
fn rolled(grid: Grid) -> Vec<f64> {
    let place = |i: usize, j: usize| {
        let angle = j as f64 / 3.0;
        let radius = 3.0 + 0.048 * angle;
        DVec3::new(radius * angle.cos(), radius * angle.sin(), i as f64)
    };
    field(place, grid)
}

fn found(grid: Grid, x: &[f64], v: &[f64]) -> Layers<f64> {
    found_of((grid, None), x, v)
}

/// As [`found`], of a cloth that may not be a full rectangle.
fn found_of(shape: (Grid, Option<Mask>), x: &[f64], v: &[f64]) -> Layers<f64> {
    in_frame(shape, x, v, |start| Layers::find(start, SETTINGS))
}

/// Returns what a search at the end of a frame finds, where accelerations have led.
fn missed(grid: Grid, x: &[f64], v: &[f64], a: &[f64]) -> Layers<f64> {
    in_frame((grid, None), x, v, |start| Layers::find_missed(start, SETTINGS, a))
}

/// Runs a search in the frame that begins with these places and velocities.
fn in_frame(
    (grid, mask): (Grid, Option<Mask>),
    x: &[f64],
    v: &[f64],
    search: impl Fn(&Approach<'_, f64>) -> Layers<f64>,
) -> Layers<f64> {
    let cloth = Cloth { self_contact: Some(SETTINGS), mask, ..Cloth::default() };
    let marks = Model { grid, cloths: vec![cloth.clone()] }.marks();
    search(&Approach { grid, cloth: &cloth, sweeps: &[], x, v, marks: &marks, handles: &[] })
}

/// The edges of a cloth: the sides of its triangles, and edges of the grid between two of its particles.
fn edges(cloth: &Cloth, grid: Grid) -> Vec<[usize; 2]> {
    let sides = cloth.faces(grid).into_iter().flat_map(|[a, b, c]| [[a, b], [b, c], [a, c]]);
    let sides = sides.map(|[a, b]| [a.min(b) as usize, a.max(b) as usize]);
    let (n, w) = (grid.particles(), grid.w);
    let right = (0..n).filter(|p| p % w + 1 < w).map(|p| [p, p + 1]);
    let down = (0..n - w).map(|p| [p, p + w]);
    let of_grid = right.chain(down).filter(|ends| ends.iter().all(|&p| cloth.contains(p)));
    sides.chain(of_grid).collect::<BTreeSet<_>>().into_iter().collect()
}

/// Returns the particles of the pairs that are near, by trying all pairs with each `stride`-th particle and edge.
fn tried((grid, mask): (Grid, Option<Mask>), x: &[f64], stride: usize) -> BTreeSet<[usize; 4]> {
    let (n, cloth) = (grid.particles(), Cloth { mask, ..Cloth::default() });
    let has = |p: usize| cloth.contains(p);
    let place = |p: usize| DVec3::new(x[p], x[n + p], x[2 * n + p]);
    let range = SETTINGS.thickness + 0.25;
    let is_near = |parts: Parts| {
        let particles = parts.particles(grid);
        (parts.distance(&particles.map(place)) < range && parts.nearest((grid, has), place).is_some())
            .then_some(particles)
    };
    // Boxes that are apart are an answer, too.
    let bounds = |particles: &[usize]| {
        let low = particles.iter().fold(DVec3::INFINITY, |low, p| low.min(place(*p)));
        (low, particles.iter().fold(DVec3::NEG_INFINITY, |high, p| high.max(place(*p))))
    };
    let apart = |one: (DVec3, DVec3), other: (DVec3, DVec3)| {
        (one.0 - range).cmpgt(other.1).any() || (other.0 - range).cmpgt(one.1).any()
    };
    let faces: Vec<_> = grid.faces().iter().map(|face| bounds(&face.map(|p| p as usize))).collect();
    let own_faces: BTreeSet<_> = cloth.faces(grid).into_iter().collect();
    let is_own: Vec<bool> = grid.faces().iter().map(|face| own_faces.contains(face)).collect();
    let edges = edges(&cloth, grid);
    let boxes: Vec<_> = edges.iter().map(|edge| bounds(edge)).collect();
    let mut near = BTreeSet::new();
    for p in (0..n).step_by(stride).filter(|&p| has(p)) {
        let own = bounds(&[p]);
        let close = (0..faces.len()).filter(|face| is_own[*face] && !apart(own, faces[*face]));
        near.extend(close.filter_map(|face| is_near(Parts::vertex(grid, p, face)?)));
    }
    for k in (0..edges.len()).step_by(stride) {
        let close = (k + 1..edges.len()).filter(|other| !apart(boxes[k], boxes[*other]));
        near.extend(close.filter_map(|other| is_near(Parts::edges(edges[k], edges[other])?)));
    }
    near
}

/// Returns a mask with holes of all shapes.
fn perforated(grid: Grid) -> Mask {
    let holes = noise(grid.particles(), 17);
    let wanted: Vec<bool> = holes.iter().map(|c| c.abs() < 0.93).collect();
    Mask::new(grid, &wanted, "a test").unwrap()
}

#[test]
fn the_search_finds_what_trying_all_pairs_finds() {
    let small = Grid { h: 12, w: 14 };
    let random: Vec<f64> = noise(3 * small.particles(), 3).iter().map(|c| 4.0 * c).collect();
    // So few that the pairs of all with all are not too many.
    let few = Grid { h: 8, w: 8 };
    let large = Grid { h: 100, w: 100 };
    let largest = Grid { h: 256, w: 256 };
    let cases = [
        ("random", small, None, random.clone(), 1),
        ("random and jagged", small, Some(jagged(small)), random, 1),
        ("coincident", few, None, vec![1.0; 3 * few.particles()], 1),
        ("flat", large, None, folded(large, 5.0), 7),
        ("folded", large, None, shaken(folded(large, 0.2), 0.05, 5), 7),
        ("rolled", large, None, shaken(rolled(large), 0.02, 6), 7),
        ("rolled and perforated", large, Some(perforated(large)), shaken(rolled(large), 0.02, 6), 7),
        ("folded 256", largest, None, shaken(folded(largest, 0.2), 0.05, 7), 331),
    ];
    for (name, grid, mask, x, stride) in cases {
        let still = vec![0.0; x.len()];
        let found: BTreeSet<[usize; 4]> =
            found_of((grid, mask.clone()), &x, &still).pairs().map(|(particles, _)| particles).collect();
        let edges = edges(&Cloth { mask: mask.clone(), ..Cloth::default() }, grid);
        let is_sampled =
            |[a, b, ..]: &[usize; 4]| edges.binary_search(&[*a, *b]).is_ok_and(|k| k % stride == 0);
        let is_vertex = |pair: &[usize; 4]| {
            edges.binary_search(&[pair[2], pair[3]]).is_err() || {
                // The corners of a triangle are joined, too; two edges meet nowhere.
                Parts::edges([pair[0], pair[1]], [pair[2], pair[3]]).is_none()
                    || edges.binary_search(&[pair[0], pair[1]]).is_err()
            }
        };
        let of_sample: BTreeSet<[usize; 4]> = found
            .iter()
            .filter(|pair| if is_vertex(pair) { pair[0] % stride == 0 } else { is_sampled(pair) })
            .copied()
            .collect();
        let expected = tried((grid, mask), &x, stride);
        assert_eq!(of_sample, expected, "{name}");
        println!("{name}: {} pairs, {} compared", found.len(), expected.len());
        assert!(name == "flat" || expected.len() > 100, "{name}: {}", expected.len());
    }
}

/// A folded sheet with one handle, whose layers press on each other and slide.
fn pressed(grid: Grid) -> (Model, State<f64>, Control<f64>, Vec<f64>) {
    let n = grid.particles();
    let cloth = Cloth {
        self_contact: Some(SETTINGS),
        material: Material { stretch: 10.0, shear: 1.0, bend: 0.1, ..Material::PAPER },
        handles: vec![5],
        ..Cloth::default()
    };
    let x = shaken(folded(grid, 0.12), 0.02, 9);
    let v =
        shaken(field(|_, j| DVec3::new(0.0, 0.0, if j > grid.w / 2 { -0.03 } else { 0.0 }), grid), 0.02, 10);
    let control = Control { handles: vec![[x[5], x[n + 5], x[2 * n + 5]]], ..Control::default() };
    let a: Vec<f64> = noise(3 * n, 11).iter().map(|a| 0.01 * a).collect();
    (Model { grid, cloths: vec![cloth] }, State { x, v }, control, a)
}

#[test]
fn gradient_and_curvature_are_derivatives_of_the_energy() {
    let grid = Grid { h: 10, w: 12 };
    let (model, state, control, a) = pressed(grid);
    let mut objective = Objective::new(&model);
    objective.begin_frame(&state, &control);
    let energy_at = |objective: &mut Objective<f64>, a: &[f64]| {
        objective.set_accelerations(a);
        objective.move_to_trial(&state, &control);
        objective.energy(&state, 0)
    };
    let terms = energy_at(&mut objective, &a);
    assert!(terms.contact > 1e-3 * terms.total().abs(), "{terms:?}");
    let mut directions: Vec<Vec<f64>> = (0..3).map(|k| noise(a.len(), 20 + k)).collect();
    for direction in &mut directions {
        (0..3).for_each(|c| direction[c * grid.particles() + 5] = 0.0);
    }
    let moved = |k: usize, step: f64| -> Vec<f64> {
        a.iter().zip(&directions[k]).map(|(a, d)| a + step * d).collect()
    };
    objective.set_accelerations(&a);
    objective.evaluate(&state, &control);
    let all = directions.concat();
    let model = objective.local_model(&state, 0, (&all, &mut CurvatureRows::new(grid)));
    let grad_along = |objective: &mut Objective<f64>, a: &[f64], k: usize| -> f64 {
        objective.set_accelerations(a);
        objective.evaluate(&state, &control);
        objective.grad().iter().zip(&directions[k]).map(|(g, d)| g * d).sum()
    };
    let h = 1e-6;
    for k in 0..3 {
        let [up, down] = [h, -h].map(|h| energy_at(&mut objective, &moved(k, h)).total());
        let slope = (up - down) / (2.0 * h);
        assert!((model.slopes[k] - slope).abs() < 1e-6 * slope.abs(), "{k}: {} and {slope}", model.slopes[k]);
        for l in 0..3 {
            let [up, down] = [h, -h].map(|h| grad_along(&mut objective, &moved(l, h), k));
            let second = (up - down) / (2.0 * h);
            let found = model.curvature[k][l];
            let size = (model.curvature[k][k] * model.curvature[l][l]).sqrt();
            assert!((found - second).abs() < 1e-5 * size, "{k} {l}: {found} and {second}");
        }
    }
}

#[test]
fn forces_sum_to_zero() {
    let grid = Grid { h: 10, w: 12 };
    let (_, State { x, v }, ..) = pressed(grid);
    let n = grid.particles();
    let mut layers = found(grid, &x, &v);
    let mut accelerations = vec![0.0; 3 * n];
    layers.move_to(&v);
    layers.add_accelerations(&mut accelerations);
    let (mut sum, mut all) = (DVec3::ZERO, 0.0);
    for p in 0..n {
        let force = grid.mass(p / grid.w, p % grid.w)
            * DVec3::new(accelerations[p], accelerations[n + p], accelerations[2 * n + p]);
        sum += force;
        all += force.length();
    }
    assert!(all > 1e-2, "{all}");
    assert!(sum.length() < 1e-12 * all, "{sum} of {all}");
    for (_, weights) in layers.pairs() {
        assert!(weights.iter().sum::<f64>().abs() < 1e-12);
    }
}

#[test]
fn parting_moves_layers_apart() {
    let grid = Grid { h: 10, w: 12 };
    let n = grid.particles();
    // The upper half would end up below the lower one; if it moves sideways, too, then parts come near each other that have
    // passed through the other layer elsewhere.
    for (apart, way) in [(0.1, [0.0, 0.0, -0.25]), (0.3, [0.5, 0.3, -0.8]), (0.3, [-0.2, 0.9, -0.5])] {
        let x = shaken(folded(grid, apart), 0.02, 9);
        let v = field(|_, j| if j > grid.w / 2 { DVec3::from(way) } else { DVec3::ZERO }, grid);
        let layers = found(grid, &x, &v);
        assert!(layers.stats(&v).nearest < 0.0, "{way:?}");
        let mut a = vec![0.0; 3 * n];
        assert!(layers.part(40, &mut a));
        let moved = |a: &[f64]| -> Vec<f64> { v.iter().zip(a).map(|(v, a)| v + a).collect() };
        assert!(layers.stats(&moved(&a)).nearest > 0.0, "{way:?}: {:?}", layers.stats(&moved(&a)));
        // What has been moved may meet where nothing was looked for.
        for _ in 0..PARTING_ROUNDS {
            missed(grid, &x, &v, &a).part(40, &mut a);
        }
        let moved = moved(&a);
        let ends: Vec<f64> = x.iter().zip(&moved).map(|(x, y)| x + y).collect();
        assert_eq!(intersections(&grid.faces(), &ends), [], "{way:?}");
    }
}

/// What happened in a scene.
struct Course {
    /// The most intersections in a frame.
    intersections: usize,
    /// In how many frames layers pressed on each other.
    pressing: usize,
    /// The least distance between layers \[edges\], as frames report it.
    nearest: f64,
}

/// Runs that many frames of a scene.
fn course(scene: &Scene, last: usize) -> Course {
    let setup = scene.setup().unwrap();
    let mut solver = Solver::<f32>::new(&setup.model, &Optimizer::spectral(), 20).unwrap();
    let mut state = setup.start.cast::<f32>();
    let mut script = Script::new(&setup);
    let mut course = Course { intersections: 0, pressing: 0, nearest: f64::INFINITY };
    for frame in 1..setup.frames().min(last) {
        if let Some(cloth) = script.enter(frame, &state) {
            solver.set_cloths(std::slice::from_ref(cloth)).unwrap();
        }
        let stats = solver.step(&mut state, &script.control(frame));
        let wide: Vec<f64> = state.x.iter().map(|&x| f64::from(x)).collect();
        course.intersections =
            course.intersections.max(intersections(&setup.model.grid.faces(), &wide).len());
        let layers = stats[0].layers.unwrap_or_default();
        course.pressing += usize::from(layers.touching > 0);
        course.nearest = course.nearest.min(layers.nearest);
    }
    course
}

fn touching_itself(name: &str, h: usize) -> Scene {
    let mut scene = Scene::named(name).unwrap();
    scene.regrid(Grid { h, w: h }).unwrap();
    Scene { repulsion: None, self_contact: Some(SelfContactSettings::default()), ..scene }
}

#[test]
fn twisted_and_folded_cloths_never_pass_through_themselves() {
    for (name, h) in [("twist", 32), ("twist", 64), ("fold-edge", 32)] {
        let Course { intersections, pressing, nearest } = course(&touching_itself(name, h), 300);
        println!("{name} at {h}: layers press in {pressing} frames, {nearest} edges apart");
        assert_eq!(intersections, 0, "{name} at {h}");
        assert!(pressing > 10, "{name} at {h}: {pressing} frames in which layers press");
        // No pairs contradict each other.
        assert!(nearest > 0.0, "{name} at {h}: {nearest}");
    }
}

/// A sheet that falls on a bar hangs from it on both sides, until two plates press its halves together.
#[test]
fn a_sheet_that_a_bar_folds_never_passes_through_itself() {
    let plate = |side: f64| {
        let place = |apart: f64| format!("[{}, -0.45, 0]", 0.5 + side * apart);
        format!(
            r#"{{"shape": "box", "sides_m": [0.02, 0.6, 1.4], "position_m": {}, "friction": 0.2, "motion": [
                {{"time_s": 1.4, "position_m": {}}}, {{"time_s": 2.4, "position_m": {}}}]}}"#,
            place(0.6),
            place(0.6),
            place(0.016)
        )
    };
    let text = format!(
        r#"{{"grid": [64, 64], "start": "flat", "handles": [], "motion": "none", "frames": 190, "self_contact": true, "bodies": [
            {{"shape": "capsule", "radius_m": 0.02, "length_m": 1.4, "position_m": [0.5, -0.1, 0], "axis": [0, 0, 1], "friction": 2}},
            {}, {}]}}"#,
        plate(1.0),
        plate(-1.0)
    );
    let scene = Scene::parse(&text, "a bar", Path::new("")).unwrap();
    let Course { intersections, pressing, nearest } = course(&scene, 190);
    println!("over a bar: layers press in {pressing} frames, {nearest} edges apart");
    assert_eq!(intersections, 0);
    assert!(pressing > 10 && nearest > 0.0, "{pressing} frames in which layers press, {nearest} edges apart");
}

#[test]
fn without_contact_they_do() {
    let scene = Scene { self_contact: None, ..touching_itself("twist", 32) };
    assert!(course(&scene, 140).intersections > 0);
}

#[test]
fn newton_converges_where_layers_press() {
    let scene = touching_itself("twist", 16);
    let setup = scene.setup().unwrap();
    let mut solver = Solver::<f64>::new(&setup.model, &Optimizer::newton(), 1).unwrap();
    let (mut state, mut script, mut pressing) = (setup.start.clone(), Script::new(&setup), 0);
    for frame in 1..150 {
        if let Some(cloth) = script.enter(frame, &state) {
            solver.set_cloths(std::slice::from_ref(cloth)).unwrap();
        }
        let stats = &solver.step(&mut state, &script.control(frame))[0];
        assert_eq!(stats.converged, Some(true), "frame {frame}");
        assert_eq!(intersections(&setup.model.grid.faces(), &state.x), [], "frame {frame}");
        pressing += usize::from(stats.layers.is_some_and(|layers| layers.touching > 0));
    }
    assert!(pressing > 10, "{pressing}");
}

#[test]
fn frames_do_not_depend_on_the_number_of_threads() {
    let setup = touching_itself("twist", 32).setup().unwrap();
    let ends = [1, 4].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut solver = Solver::<f32>::new(&setup.model, &Optimizer::spectral(), 5).unwrap();
            let (mut state, mut script) = (setup.start.cast::<f32>(), Script::new(&setup));
            for frame in 1..110 {
                if let Some(cloth) = script.enter(frame, &state) {
                    solver.set_cloths(std::slice::from_ref(cloth)).unwrap();
                }
                solver.step(&mut state, &script.control(frame));
            }
            state
        })
    });
    assert_eq!(ends[0], ends[1]);
}

/// All particles of a cloth at one point are near each other: too many pairs to keep, and an error that says so.
#[test]
fn a_cloth_that_has_collapsed_is_an_error() {
    let grid = Grid { h: 32, w: 32 };
    let x = vec![1.0; 3 * grid.particles()];
    let layers = found(grid, &x, &vec![0.0; x.len()]);
    assert!(layers.stats(&vec![0.0; x.len()]).overflow.is_some() && layers.pairs().count() == 0);
    let cloth = Cloth { self_contact: Some(SETTINGS), ..Cloth::default() };
    let model = Model { grid, cloths: vec![cloth] };
    let mut simulator = Simulator::new(&Device::Cpu, &model, &Optimizer::spectral(), 2).unwrap();
    simulator.set_state(&State { x: vec![1.0; x.len()], v: vec![0.0; x.len()] });
    let error = simulator.step(&Control::default()).unwrap_err().to_string();
    for said in ["frame 1, cloth 0", "self-contact", "128 pairs", "collapsed"] {
        assert!(error.contains(said), "no '{said}' in: {error}");
    }
}

/// Half of a sheet without stiffness lies on the other half, which is held, under gravity that is not straight down: it
/// sticks where the friction is above the tangent of the angle, else it slides with `G (sin - mu cos)`.
#[test]
fn layers_slide_on_each_other_as_friction_allows() {
    let grid = Grid { h: 24, w: 16 };
    let n = grid.particles();
    let (gravity, tangent) = (0.05, 0.3f64);
    let cosine = (1.0 + tangent * tangent).sqrt().recip();
    let x = folded(grid, 0.155);
    let held: Vec<usize> = (0..n).filter(|p| p % grid.w <= grid.w / 2).collect();
    let control = Control {
        handles: held.iter().map(|&p| [x[p], x[n + p], x[2 * n + p]]).collect(),
        ..Control::default()
    };
    for friction in [0.4, 0.2, 0.1] {
        let cloth = Cloth {
            material: Material { stretch: 0.0, shear: 0.0, bend: 0.0, ..Material::PAPER },
            gravity: [0.0, gravity * tangent * cosine, -gravity * cosine],
            self_contact: Some(SelfContact { thickness: 0.16, friction }),
            handles: held.clone(),
            ..Cloth::default()
        };
        let model = Model { grid, cloths: vec![cloth] };
        let mut solver = Solver::<f64>::new(&model, &Optimizer::newton(), 1).unwrap();
        let mut state = State { x: x.clone(), v: vec![0.0; 3 * n] };
        // In the middle of the layer, where nothing hangs over a border.
        let watched = (9..14).flat_map(|i| (11..14).map(move |j| i * 16 + j));
        let speed = |state: &State<f64>| watched.clone().map(|p| state.v[n + p]).sum::<f64>() / 15.0;
        let mut speeds = Vec::new();
        for _ in 0..9 {
            solver.step(&mut state, &control);
            speeds.push(speed(&state));
        }
        let expected = gravity * cosine * (tangent - friction);
        if expected < 0.0 {
            // Friction is rounded off, so a minimum lets the layer creep by this share of the speed at which it slides. Most of that
            // is taken back.
            let creep = tangent / friction * Contact::STICKING;
            println!("{friction}: {} of {creep}", speeds[8]);
            assert!(speeds[8].abs() < 0.2 * creep, "{friction}: {}", speeds[8]);
            continue;
        }
        // From where the layer lies at rest, to where what hangs over the border tells.
        let found = (speeds[8] - speeds[2]) / 6.0;
        assert!((found - expected).abs() < 0.02 * expected, "{friction}: {found}, not {expected}");
    }
}
