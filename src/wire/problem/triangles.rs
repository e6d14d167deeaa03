//! How many triangles a mesh file claims to have, before anything is built from it.

/// The number of triangles that a mesh file announces; an upper bound that costs one look at the bytes.
/// COLLADA files, which announce nothing, count by the numbers that they hold.
pub fn announced(bytes: &[u8]) -> usize {
    let text = bytes.trim_ascii_start();
    if text.starts_with(b"solid") && !is_binary_stl(bytes) {
        return count_lines(bytes, |line| line.starts_with(b"endfacet"));
    }
    if text.starts_with(b"<") {
        // Three corners of a triangle, each an index at least, with a space behind it.
        return bytes.len() / 6;
    }
    if is_binary_stl(bytes) {
        return bytes.len().saturating_sub(84) / 50;
    }
    // A polygon of n corners becomes n - 2 triangles.
    let corners = |line: &[u8]| line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).count();
    let faces = lines(bytes).filter(|line| line.starts_with(b"f "));
    faces.map(|line| corners(line).saturating_sub(3)).sum()
}

fn is_binary_stl(bytes: &[u8]) -> bool {
    let count = bytes.get(80..84).and_then(|field| <[u8; 4]>::try_from(field).ok()).map(u32::from_le_bytes);
    count.is_some_and(|count| bytes.len() as u64 == 84 + 50 * u64::from(count))
}

fn lines(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    bytes.split(|byte| matches!(byte, b'\n' | b'\r')).map(<[u8]>::trim_ascii_start)
}

fn count_lines(bytes: &[u8], wanted: impl Fn(&[u8]) -> bool) -> usize {
    lines(bytes).filter(|line| wanted(line)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_each_kind_are_counted() {
        let mut stl = vec![0_u8; 80];
        stl.extend(7_u32.to_le_bytes());
        stl.extend([0; 350]);
        assert_eq!(announced(&stl), 7);
        stl[..5].copy_from_slice(b"solid");
        assert_eq!(announced(&stl), 7);
        let ascii = "solid x\n facet normal 0 0 1\n outer loop\n endloop\n endfacet\nendsolid x\n";
        assert_eq!(announced(ascii.as_bytes()), 1);
        assert_eq!(announced(b"v 0 0 0\nf 1 2 3\n  f 1//2 2//2 3//2 4//2\n"), 3);
        assert_eq!(announced(b""), 0);
    }
}
