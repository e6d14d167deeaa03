//! The service over real sockets, with a planner that follows a script: jobs, streams, bad input, shutdown, gRPC,
//! durability, limits, the written interface, foreign clients.
//!
//! `QUADRILLE_SOAK=1` runs the long forms of kills, load and fuzzing; `make soak` runs them all and prints their figures.

mod bad_input;
mod durable;
mod figures;
mod foreign;
mod fuzz;
mod grpc;
mod jobs;
mod kills;
mod load;
mod openapi;
mod operations;
mod process;
mod requests;
mod resources;
mod schema;
mod script;
mod server;
mod streams;
mod workcells;
