//! Whether rectangles fit on a rectangle, by shelves: first fit, decreasing depth (Coffman,
//! Garey, Johnson and Tarjan 1980). Finding no packing proves nothing; a packing that is found is
//! one.

/// Whether `items` (width, depth; m) are packed on an `area` (width, depth; m), by shelves along
/// either side, each item turned with its longer side along the shelf.
pub fn is_packed(items: &[[f64; 2]], area: [f64; 2]) -> bool {
    on_shelves(items, area) || on_shelves(items, [area[1], area[0]])
}

fn on_shelves(items: &[[f64; 2]], [length, depth]: [f64; 2]) -> bool {
    // What rounding may take (m).
    const PLAY: f64 = 1.0e-9;
    let mut items: Vec<[f64; 2]> = items.iter().map(|[a, b]| [a.max(*b), a.min(*b)]).collect();
    items.sort_by(|a, b| b[1].total_cmp(&a[1]).then(b[0].total_cmp(&a[0])));
    // Length left on each shelf; items come in falling depth, so the first one sets a shelf's.
    let mut shelves: Vec<f64> = Vec::new();
    let mut used = 0.0;
    for [long, short] in items {
        if let Some(left) = shelves.iter_mut().find(|left| **left + PLAY >= long) {
            *left -= long;
        } else if long <= length + PLAY && used + short <= depth + PLAY {
            used += short;
            shelves.push(length - long);
        } else {
            return false;
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fits_and_what_does_not() {
        assert!(is_packed(&[[0.1, 0.1]; 25], [0.5, 0.5]));
        assert!(!is_packed(&[[0.1, 0.1]; 26], [0.5, 0.5]));
        assert!(is_packed(&[[0.2, 0.6]; 2], [0.6, 0.4]) && is_packed(&[[0.2, 0.6]; 2], [0.4, 0.6]));
        assert!(!is_packed(&[[0.7, 0.1]], [0.5, 0.5]));
        assert!(is_packed(&[], [0.1, 0.1]));
    }
}
