//! The judge against hand-made plans.

mod contacts;
mod gantry;
mod rules;
