//! A lower bound on the distance between two boxes.

use super::float8::{Float8, V3, dot3, sub3};

/// A box in each lane.
#[derive(Clone, Copy)]
pub struct Box8<F> {
    /// Its centre (m).
    pub centre: V3<F>,
    /// Its three axes, unit vectors at right angles.
    pub axes: [V3<F>; 3],
    /// Its half extents along them (m).
    pub half: V3<F>,
}

/// The widest gap (m) between two boxes along the 15 axes that can separate them: never more than
/// their distance, and negative only when they overlap.
///
/// Gottschalk, Lin and Manocha 1996, with the cross products brought to unit length; those of nearly
/// parallel edges say nothing that the faces do not, and are left out.
#[inline(always)]
pub fn box_box_gap<F: Float8>(a: &Box8<F>, b: &Box8<F>) -> F {
    let offset = sub3(&b.centre, &a.centre);
    let zero = F::splat(0.0);
    let mut cosines = [[zero; 3]; 3];
    let mut sizes = [[zero; 3]; 3];
    let mut in_a = [zero; 3];
    for i in 0..3 {
        in_a[i] = dot3(&offset, &a.axes[i]);
        for j in 0..3 {
            cosines[i][j] = dot3(&a.axes[i], &b.axes[j]);
            sizes[i][j] = cosines[i][j].abs();
        }
    }
    let mut widest = F::splat(f32::NEG_INFINITY);
    for i in 0..3 {
        let reach = dot3(&b.half, &sizes[i]);
        widest = widest.max(in_a[i].abs() - a.half[i] - reach);
        let reach = dot3(&a.half, &[sizes[0][i], sizes[1][i], sizes[2][i]]);
        widest = widest.max(dot3(&offset, &b.axes[i]).abs() - b.half[i] - reach);
    }
    for i in 0..3 {
        let (i1, i2) = ((i + 1) % 3, (i + 2) % 3);
        for j in 0..3 {
            let (j1, j2) = ((j + 1) % 3, (j + 2) % 3);
            let reach_a = a.half[i1].mul_add(sizes[i2][j], a.half[i2] * sizes[i1][j]);
            let reach_b = b.half[j1].mul_add(sizes[i][j2], b.half[j2] * sizes[i][j1]);
            let between = in_a[i2].mul_add(cosines[i1][j], -(in_a[i1] * cosines[i2][j])).abs();
            let square = cosines[i1][j].mul_add(cosines[i1][j], cosines[i2][j] * cosines[i2][j]);
            let slanted = F::splat(1e-3).less(square);
            let gap = (between - reach_a - reach_b).div(square.max(F::splat(1e-3)).sqrt());
            widest = F::select(slanted, widest.max(gap), widest);
        }
    }
    widest
}
