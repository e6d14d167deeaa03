//! Compiles the gRPC interface, without a protoc on the machine.

use std::error::Error;
use std::path::PathBuf;

const INTERFACE: &str = "quadrille/v1/planning.proto";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=api/{INTERFACE}");
    let mut compiler = protox::Compiler::new(["api"])?;
    compiler.include_source_info(true).include_imports(true).open_file(INTERFACE)?;
    let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or("cargo sets OUT_DIR")?);
    // What the reflection service answers from.
    std::fs::write(out.join("planning.descriptors"), compiler.encode_file_descriptor_set())?;
    tonic_prost_build::configure().compile_fds(compiler.file_descriptor_set())?;
    Ok(())
}
