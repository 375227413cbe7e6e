fn main() {
    let ctx = fnopt::gpu::Context::headless(&fnopt::gpu::AdapterChoice::Best).unwrap();
    let mut s = fnopt::verify::GpuStages::new(&ctx);
    fnopt::verify::verify_folder(std::path::Path::new("/work/shared/golden"), &mut s, &mut |c| {
        println!("{c}")
    })
    .unwrap();
}
