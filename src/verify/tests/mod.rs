//! The judge against hand-made plans.

mod contacts;
mod foreign;
mod gantry;
mod rules;
