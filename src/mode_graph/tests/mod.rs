//! Mode graphs of small cells, with reach by plain distances.

mod carries;
mod cell;
mod graphs;
mod proofs;
