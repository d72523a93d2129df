//! Encapsulated pixels: which fragments make up each frame (PS3.5 annex A.4).

/// A run of bytes in a file: offset and length.
pub(super) type Fragment = (u64, u32);

/// The fragments of each frame.
///
/// * `offsets`: those of the basic or extended offset table, bytes from the first fragment's item;
///   empty where the file has none.
/// * `begins_stream`: whether a fragment's first bytes begin a stream of its own.
///
/// # Errors
/// Why they cannot be told apart.
pub(super) fn frames(
    fragments: &[Fragment],
    offsets: &[u64],
    frames: usize,
    begins_stream: impl Fn(&Fragment) -> bool,
) -> Result<Vec<Vec<Fragment>>, String> {
    if fragments.is_empty() || frames == 0 {
        return Err("no fragments".into());
    }
    if frames == 1 {
        return Ok(vec![fragments.to_vec()]);
    }
    if fragments.len() == frames {
        return Ok(fragments.iter().map(|f| vec![*f]).collect());
    }
    let starts: Vec<usize> = if offsets.len() == frames {
        // A fragment's item has eight bytes of head.
        let first = fragments[0].0 - 8;
        // They follow each other in the file.
        let place = |o: &u64| fragments.binary_search_by_key(o, |f| f.0 - 8 - first).ok();
        let found: Option<Vec<usize>> = offsets.iter().map(place).collect();
        found.ok_or("an offset that leads to no fragment")?
    } else {
        (0..fragments.len()).filter(|i| begins_stream(&fragments[*i])).collect()
    };
    let ascending = starts.windows(2).all(|w| w[0] < w[1]);
    if starts.len() != frames || starts[0] != 0 || !ascending {
        return Err(format!("{} fragments for {frames} frames", fragments.len()));
    }
    let ends = starts.iter().skip(1).copied().chain([fragments.len()]);
    Ok(starts.iter().zip(ends).map(|(a, b)| fragments[*a..b].to_vec()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fragments_are_shared_out_by_table_by_number_or_by_their_beginnings() {
        let all: Vec<Fragment> = vec![(108, 10), (126, 20), (154, 4), (166, 8)];
        let never = |_: &Fragment| false;
        let one = frames(&all, &[], 1, never).unwrap();
        assert!(one.len() == 1 && one[0] == all);
        assert_eq!(frames(&all, &[], 4, never).unwrap().len(), 4);
        let two = [all[..2].to_vec(), all[2..].to_vec()];
        assert_eq!(frames(&all, &[0, 46], 2, never).unwrap(), two);
        let begins = |f: &Fragment| f.0 == 108 || f.0 == 154;
        assert_eq!(frames(&all, &[], 2, begins).unwrap(), two);
        assert!(frames(&all, &[0, 45], 2, never).is_err());
        assert!(frames(&all, &[], 3, begins).is_err());
        assert!(frames(&all, &[46, 0], 2, never).is_err());
        assert!(frames(&[], &[], 1, never).is_err());
    }

    #[test]
    fn an_offset_table_of_many_entries_takes_no_square_of_their_number() {
        let fragments: Vec<Fragment> = (0..1 << 18).map(|i| (108 + 10 * i, 2)).collect();
        let offsets: Vec<u64> = (0..(1 << 17) - 1).map(|i| 20 * i).collect();
        let began = std::time::Instant::now();
        let got = frames(&fragments, &offsets, offsets.len(), |_| false).unwrap();
        println!("{} entries: {:.3} s", offsets.len(), began.elapsed().as_secs_f64());
        assert_eq!((got[1].len(), got[1][0].0), (2, 128));
        assert!(began.elapsed().as_secs_f64() < 2.0);
    }
}
