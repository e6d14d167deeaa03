//! The service as its clients see it, over real sockets, with a scripted planner.

mod bad_input;
mod grpc;
mod jobs;
mod resources;
mod script;
mod server;
mod streams;
