//! What dispatches do, counted without running them.

use super::common::{context, tensor};
use fnopt::gpu::{CARDS, Schedule};
use fnopt::kernels::operator::MultiplyAdd;
use fnopt::network::Weights;
use fnopt::scene::Scene;
use fnopt::sim::{Optimizer, Solver};

#[test]
fn operations_of_multiply_adds_are_those_that_are_documented() {
    let zeros = vec![0.0; 1 << 12];
    let [x, y] = ["x", "y"].map(|label| tensor(label, &[1 << 12], &zeros));
    let mut schedule = Schedule::new(context());
    MultiplyAdd::new(context()).unwrap().push(&mut schedule, (100, 0.5, 1.0), &x, &y);
    let [(name, work)] = schedule.work(&CARDS[0])[..] else { panic!("one dispatch") };
    let all = work.operations * work.groups as f64 * f64::from(work.invocations);
    // With four sums and differences more for each element.
    let expected = ((100 * MultiplyAdd::FLOP + 4) << 12) as f64;
    assert_eq!((name, all), ("multiply_add", expected));
    // Three chains of 16 multiply-adds, each of four instructions, and nothing to wait for.
    assert!((0.9..1.2).contains(&(work.instructions / (100.0 * 3.0 * 16.0 * 4.0))), "{work:?}");
}

/// Every kernel of the frames of all solvers and terms can be walked through, and takes each card some time.
#[test]
fn frames_are_predicted() {
    for (scene, solver) in [
        ("default", "fnopt:6"),
        ("default", "fnopt-paper:2"),
        ("default", "quasi-newton:2"),
        ("default", "lbfgs:2"),
        ("default", "adam:2"),
        ("default", "gd:2"),
        ("sphere", "spectral:2"),
        ("twist", "spectral:2"),
        ("pleats", "spectral:2"),
        ("fold-edge", "spectral:2"),
    ] {
        let scene = match scene {
            "default" => Scene::parse("{}", "a test", "".as_ref()),
            name => Scene::named(name),
        };
        let setup = scene.unwrap().setup().unwrap();
        let (name, iterations) = solver.split_once(':').unwrap();
        let optimizer = Optimizer::named(name, "a test", || Ok(Weights::shipped())).unwrap();
        let frame = Solver::new(context(), &setup.model, &optimizer, iterations.parse().unwrap()).unwrap();
        let schedule = frame.schedule();
        for card in CARDS {
            let work = schedule.work(card);
            assert_eq!(work.len(), schedule.dispatches(), "{solver}");
            assert_eq!(work, schedule.work(card));
            for (name, work) in work {
                let (seconds, bound) = card.seconds(&work);
                let found =
                    format!("{solver}, {name} on {}: {seconds} s, {}, {work:?}", card.name, bound.name());
                assert!((1e-9..1e-2).contains(&seconds), "{found}");
                assert!(work.cycles >= work.instructions - 1.0 && work.instructions > 1.0, "{found}");
            }
        }
    }
}
