//! Mode graphs of small cells, with reach by plain distances.

mod cell;
mod graphs;
mod proofs;
