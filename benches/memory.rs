//! `cargo bench -p dpges-benches --bench memory`: the most memory that 20 training steps take.
//! Each variant runs in a process of its own, since a process' peak never falls.

use std::process::Command;

use dpges_benches::training::{Training, Variant};
use dpges_benches::{cpus, machine, resident_mib};
use dpges_core::testing::scenes::realistic;

const STEPS: usize = 20;
const VARIANTS: [Variant; 2] = [Variant::OWN, Variant::PLAIN];

fn measure(backend: &str, variant: Variant, size: usize) {
    let (_, device) = cpus().into_iter().find(|(name, _)| *name == backend).expect("a CPU backend");
    let scene = realistic(10_000, 100_000, size, size, 1);
    let mut training = Training::new(&scene, &device);
    let before = resident_mib("VmRSS");
    let loss = (0..STEPS).map(|_| training.step(variant)).last().unwrap_or(f64::NAN);
    let peak = resident_mib("VmHWM");
    println!(
        "{backend}, {size} × {size} px, {}: {before:.0} MiB before, {peak:.0} MiB peak (loss {loss:.4})",
        variant.name()
    );
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [flag, backend, variant, size] = arguments.as_slice()
        && flag == "--measure"
    {
        let variant = VARIANTS[variant.parse::<usize>().expect("a number")];
        return measure(backend, variant, size.parse().expect("a number"));
    }
    println!("{}; 10000 surfels, 100000 Gaussians, {STEPS} steps", machine());
    let own_path = std::env::current_exe().expect("this program has a path");
    for (backend, _) in cpus() {
        for (variant, size) in [(0, 400), (1, 400), (0, 800)] {
            let status = Command::new(&own_path)
                .args(["--measure", backend, &variant.to_string(), &size.to_string()])
                .status()
                .expect("this program can be run");
            assert!(status.success(), "{backend}: {status}");
        }
    }
}
