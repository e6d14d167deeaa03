//! How many triangles a mesh file claims to have, before anything is built from it.

/// The number of triangles that the mesh file called `name` announces; an upper bound that costs one look
/// at the bytes. COLLADA files, which announce nothing, count by the numbers that they hold.
pub fn announced(name: &str, bytes: &[u8]) -> usize {
    let ending = name.rsplit('.').next().unwrap_or_default();
    if ending.eq_ignore_ascii_case("obj") {
        return polygons(bytes);
    }
    let text = bytes.trim_ascii_start();
    if text.starts_with(b"solid") && !is_binary_stl(bytes) {
        return count_lines(bytes, |line| line.starts_with(b"endfacet"));
    }
    if text.starts_with(b"<") {
        // Three corners of a triangle, each an index at least, with a space behind it.
        return bytes.len() / 6;
    }
    if is_binary_stl(bytes) || ending.eq_ignore_ascii_case("stl") {
        return bytes.len().saturating_sub(84) / 50;
    }
    polygons(bytes)
}

/// The triangles of an OBJ file: a polygon of n corners becomes n - 2 of them.
fn polygons(bytes: &[u8]) -> usize {
    if bytes.starts_with(&[0xfe, 0xff]) || bytes.starts_with(&[0xff, 0xfe]) {
        // UTF-16: a corner is an index and a space at least, of two bytes each.
        return bytes.len() / 4;
    }
    let bytes = bytes.strip_prefix("\u{feff}".as_bytes()).unwrap_or(bytes);
    let mut triangles = 0;
    // Whether a face goes on in the next line.
    let mut goes_on = false;
    for line in lines(bytes) {
        let begins = matches!(line, [b'f', next, ..] if next.is_ascii_whitespace() || *next == b'\\');
        if begins || goes_on {
            let words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).count();
            // One that is none is work, too: it may begin a group.
            triangles += if begins { words.saturating_sub(3).max(1) } else { words };
        }
        // An empty line may be the middle of a line's end of two characters.
        goes_on = (begins || goes_on) && (line.is_empty() || line.ends_with(b"\\"));
    }
    triangles
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
        assert_eq!(announced("a.stl", &stl), 7);
        stl[..5].copy_from_slice(b"solid");
        assert_eq!(announced("a.stl", &stl), 7);
        // Something behind the triangles hides none of them.
        stl[..5].fill(0);
        stl.push(0);
        assert_eq!(announced("a.stl", &stl), 7);
        let ascii = "solid x\n facet normal 0 0 1\n outer loop\n endloop\n endfacet\nendsolid x\n";
        assert_eq!(announced("a.stl", ascii.as_bytes()), 1);
        assert_eq!(announced("a", b"v 0 0 0\nf 1 2 3\n  f 1//2 2//2 3//2 4//2\n"), 3);
        assert_eq!(announced("a.stl", b""), 0);
        assert_eq!(announced("a", b""), 0);
    }

    #[test]
    fn faces_count_however_they_are_written() {
        let count = |text: &str| announced("a.OBJ", text.as_bytes());
        for face in ["f 1 2 3\n", "f\t1 2 3\n", "f\t1\t2\t3\r\n", "f  1 2 3", "\u{feff}f 1 2 3\n"] {
            assert_eq!(count(face), 1, "{face:?}");
        }
        assert_eq!(count("v 0 0 0\nvn 0 0 1\nfoo 1 2 3\n# f 1 2 3\nf\t1 2 3 4\n"), 2);
        // What the file begins with does not make another kind of it.
        assert_eq!(count("solid\nf 1 2 3\n"), 1);
        assert_eq!(count("<\nf 1 2 3\n"), 1);
        assert!(count("f\\\n1 2 3\n") >= 1);
        assert!(count("f \\\r\n1 2 3 4\n") >= 2);
        assert_eq!(count("f 1 2 3\n1 2 3\n"), 1);
        let wide = "f 1 1 1 1 1".encode_utf16().flat_map(u16::to_le_bytes);
        let wide: Vec<u8> = [0xff, 0xfe].into_iter().chain(wide).collect();
        assert!(announced("a.obj", &wide) >= 3);
    }
}
