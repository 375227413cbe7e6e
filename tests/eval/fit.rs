//! The search for a material.

use crate::common::{SETTINGS, shipped};
use fnopt::cloth::{Grid, Material, State};
use fnopt::eval::fit::{ErrorSurface, Fit};
use fnopt::eval::{Sequence, Settings};
use fnopt::io::Trajectory;
use fnopt::scene::{Motion, Scene, Start, Stiffness};
use fnopt::sim::Optimizer;
use fnopt::{Device, Simulator};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The fit recovers the material of a trajectory made by Newton's method, also when it resumes from a file.
#[test]
fn a_known_material_is_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("made");
    std::fs::create_dir(&to).unwrap();
    let truth = Material { stretch: 400.0, shear: 4.0, bend: 0.5, ..Material::PAPER };
    let mut scene = Scene {
        stiffness: Stiffness::Grid(truth),
        frames: Some(20),
        start: Start::Flat,
        motion: Motion::Still,
        ..Scene::default()
    };
    scene.regrid(Grid { h: 12, w: 12 }).unwrap();
    let setup = scene.setup().unwrap();
    let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &Optimizer::newton(), 1).unwrap();
    simulator.set_state(&setup.start.cast());
    let mut trajectory = Trajectory::new(setup.model.grid, 60.0);
    let mut handles = Vec::new();
    let mut push = |state: &State<f32>| {
        let vertices: Vec<[f32; 3]> =
            setup.vertices_m(&state.x).iter().map(|p| p.map(|c| c as f32)).collect();
        handles.extend([vertices[11 * 12], vertices[0]].concat());
        trajectory.push(&vertices, &vertices);
    };
    push(&setup.start.cast());
    for frame in 1..20 {
        push(&simulator.step(&setup.control(frame)).unwrap().state);
    }
    trajectory.write(&to, "cloth_pos", fnopt::io::Format::Npy).unwrap();
    let handles = ndarray::Array3::from_shape_vec((20, 2, 3), handles).unwrap();
    ndarray_npy::write_npy(to.join("handles.npy"), &handles).unwrap();

    let sequences = [Sequence::load(folder.path(), "made").unwrap()];
    let [density, drag, time] = sequences[0].air_and_frame_time();
    let fit = Fit {
        sequences: &sequences,
        grid: Grid { h: 12, w: 12 },
        settings: Settings { frames: 20, ..SETTINGS },
        // The refinement visits the true material: 100 * 16^(1/2) = 400.
        ranges: [[100.0, 1600.0], [1.0, 16.0], [0.5; 2], [density; 2], [drag; 2], [time; 2]],
        levels: 2,
        rounds: 1,
    };
    let file = folder.path().join("fit.csv");
    let mut surface = ErrorSurface::load(&file, &fit).unwrap();
    // Interrupts the search after 40 frames, about two points of 19 frames each.
    let frames = AtomicUsize::new(0);
    let few = || match frames.fetch_add(1, Ordering::Relaxed) {
        40.. => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    // Two threads, regardless of the machine.
    let two = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    two.install(|| fit.search(&mut surface, few, |_, _| Ok(()))).unwrap();
    assert!(!surface.sorted().is_empty(), "nothing was tried in time");
    surface.write(&file).unwrap();
    let mut again = ErrorSurface::load(&file, &fit).unwrap();
    assert_eq!(again, surface, "what was tried is known again");
    let known = again.sorted().len();
    fit.search(&mut again, || ControlFlow::Continue(()), |_, _| Ok(())).unwrap();
    assert!(again.sorted().len() > known);
    surface.add(&again);
    assert_eq!(surface, again, "what another search has found is known, too");
    let ([stretch, shear, ..], error) = again.sorted()[0];
    assert!((stretch / 400.0 - 1.0).abs() < 1e-9 && (shear / 4.0 - 1.0).abs() < 1e-9, "{stretch}, {shear}");
    // The error of sampling two equal surfaces remains.
    assert!(error < 3e-3, "{error}");
    // A file of errors over another number of frames is refused.
    let shorter = Fit { settings: Settings { frames: 10, ..fit.settings }, ..fit.clone() };
    let refused = ErrorSurface::load(&file, &shorter).unwrap_err().to_string();
    assert!(refused.contains("line 1: expected # made (10 frames, "), "{refused}");
    // So is one made with other files of the sequence.
    std::fs::write(to.join("meta.json"), r#"{"gravity_m_s2": [0, -9.7, 0]}"#).unwrap();
    let changed = [Sequence::load(folder.path(), "made").unwrap()];
    let changed = Fit { sequences: &changed, ..fit.clone() };
    assert!(
        ErrorSurface::load(&file, &changed).unwrap_err().to_string().contains("line 1: expected # made (20")
    );
    // Damaged lines are refused by number.
    let heads = "stretch,shear,bend,density,drag,frame_time,e_cd";
    for (heads, line, said) in [
        (heads, "1,2", "line 3: expected seven numbers"),
        (heads, "1,2,x,3,4,5,6,7", "line 3: expected seven numbers"),
        (heads, "1,2,3,4,5,6,-7", "line 3: expected numbers that are not negative"),
        (heads, "1,2,3,4,5,6,NaN", "line 3: expected numbers that are not negative"),
        (
            "shear,stretch,bend,density,drag,frame_time,e_cd",
            "1,2,3,4,5,6,7",
            "line 2: expected stretch,shear",
        ),
    ] {
        std::fs::write(&file, format!("# {}\n{heads}\n{line}\n", fit.subject())).unwrap();
        let refused = ErrorSurface::load(&file, &fit).unwrap_err().to_string();
        assert!(refused.contains(said), "{refused}");
    }
    let endless = Fit { levels: 1000, ..fit.clone() };
    let refused = endless.search(&mut ErrorSurface::default(), || ControlFlow::Break(()), |_, _| Ok(()));
    let refused = refused.unwrap_err().to_string();
    assert!(refused.contains("fit: levels") && refused.contains("100000"), "{refused}");
    // Points of another search are kept but not used.
    let elsewhere =
        Fit { ranges: [[800.0, 1600.0], fit.ranges[1], [0.5; 2], [density; 2], [drag; 2], [time; 2]], ..fit };
    let found = elsewhere.found(&again);
    assert!(!found.is_empty() && found.len() < again.sorted().len());
    assert!(found.iter().all(|(point, _)| point[0] >= 800.0), "{found:?}");
}

/// Where Newton's method does not converge, the distance from the truth says nothing about the material.
#[test]
fn a_material_without_a_converged_simulation_is_not_the_best() {
    let sequences = [Sequence::load(&shipped(), "xy_v2").unwrap()];
    let [density, drag, time] = sequences[0].air_and_frame_time();
    let fit = Fit {
        sequences: &sequences,
        grid: Grid { h: 8, w: 8 },
        settings: Settings { frames: 3, ..SETTINGS },
        ranges: [[1e25; 2], [8.0; 2], [0.5; 2], [density; 2], [drag; 2], [time; 2]],
        levels: 2,
        rounds: 1,
    };
    let mut surface = ErrorSurface::load(Path::new("there is none"), &fit).unwrap();
    let error = fit.search(&mut surface, || ControlFlow::Continue(()), |_, _| Ok(())).unwrap_err();
    assert!(error.to_string().contains("a point that does not diverge"), "{error}");
    assert_eq!(surface.sorted()[0].1, f64::INFINITY);
}
