//! Frames that other programs saved: grey PNG and binary PGM of 8 or 16 bits, values as they are.

use std::io::Cursor;

use thiserror::Error;

/// A picture of one channel.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct GreyImage {
    pub width: usize,
    pub height: usize,
    /// Row by row.
    pub samples: Vec<u16>,
}

/// Why a file is no frame.
#[derive(Debug, Clone, PartialEq, Error)]
pub(super) enum GreyError {
    /// Perhaps it is still being written.
    #[error("it is not whole: {0}")]
    Unfinished(String),
    /// It will not do.
    #[error("{0}: save the sensor's raw values as grey PNG or PGM of 8 or 16 bits (e.g. `dcraw -D -4` makes a PGM)")]
    Unusable(&'static str),
}

impl GreyImage {
    /// Reads a file's bytes; what they are, they say themselves.
    pub fn of(bytes: &[u8]) -> Result<Self, GreyError> {
        match bytes {
            [0x89, b'P', b'N', b'G', ..] => png(bytes),
            [b'P', b'5', ..] => pgm(bytes),
            start if b"\x89PNG".starts_with(start) || b"P5".starts_with(start) => {
                Err(GreyError::Unfinished("nothing in it yet".into()))
            }
            _ => Err(GreyError::Unusable("it is neither PNG nor binary PGM")),
        }
    }
}

fn png(bytes: &[u8]) -> Result<GreyImage, GreyError> {
    let unfinished = |e: png::DecodingError| GreyError::Unfinished(e.to_string());
    let mut reader = png::Decoder::new(Cursor::new(bytes)).read_info().map_err(unfinished)?;
    let info = reader.info();
    if info.color_type != png::ColorType::Grayscale {
        return Err(GreyError::Unusable("it has colours, so that its samples are no sensor values"));
    }
    let depth = info.bit_depth;
    let size = reader.output_buffer_size().ok_or(GreyError::Unusable("it is too large"))?;
    let mut buffer = vec![0; size];
    let frame = reader.next_frame(&mut buffer).map_err(unfinished)?;
    let samples = match depth {
        png::BitDepth::Sixteen => words(&buffer),
        png::BitDepth::Eight => buffer.iter().map(|&b| u16::from(b)).collect(),
        _ => return Err(GreyError::Unusable("its samples have fewer than 8 bits")),
    };
    Ok(GreyImage { width: frame.width as usize, height: frame.height as usize, samples })
}

/// Magic, width, height and the largest value in ASCII with comments between, one blank, then samples.
fn pgm(bytes: &[u8]) -> Result<GreyImage, GreyError> {
    let unfinished = || GreyError::Unfinished("its header ends early".into());
    let (mut at, mut numbers) = (2, [0usize; 3]);
    for number in &mut numbers {
        loop {
            match bytes.get(at).ok_or_else(unfinished)? {
                b'#' => at += bytes[at..].iter().position(|&b| b == b'\n').ok_or_else(unfinished)?,
                b if b.is_ascii_whitespace() => at += 1,
                _ => break,
            }
        }
        let digits = bytes[at..].iter().take_while(|b| b.is_ascii_digit()).count();
        let text = std::str::from_utf8(&bytes[at..at + digits]).unwrap_or_default();
        *number = text.parse().map_err(|_| GreyError::Unusable("its header is no PGM's"))?;
        at += digits;
    }
    let [width, height, largest] = numbers;
    let each = if largest > 255 { 2 } else { 1 };
    let length = width.checked_mul(height).and_then(|n| n.checked_mul(each));
    let length =
        length.filter(|_| (1..=65535).contains(&largest)).ok_or(GreyError::Unusable("its header is no PGM's"))?;
    let body = bytes.get(at + 1..).ok_or_else(unfinished)?;
    if body.len() < length {
        return Err(GreyError::Unfinished(format!("{} of {length} bytes", body.len())));
    }
    let body = &body[..length];
    let samples = if each == 2 { words(body) } else { body.iter().map(|&b| u16::from(b)).collect() };
    Ok(GreyImage { width, height, samples })
}

fn words(bytes: &[u8]) -> Vec<u16> {
    bytes.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encoded(colour: png::ColorType, depth: png::BitDepth, data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, 2, 2);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        encoder.write_header().unwrap().write_image_data(data).unwrap();
        bytes
    }

    #[test]
    fn values_come_as_they_are() {
        let samples = vec![0, 1, 4095, 65535];
        let words: Vec<u8> = samples.iter().flat_map(|s: &u16| s.to_be_bytes()).collect();
        let image = GreyImage { width: 2, height: 2, samples };
        assert_eq!(GreyImage::of(&encoded(png::ColorType::Grayscale, png::BitDepth::Sixteen, &words)).unwrap(), image);
        let pgm = [b"P5\n# a camera\n2 2 # size\n65535\n".as_slice(), &words].concat();
        assert_eq!(GreyImage::of(&pgm).unwrap(), image);
        let bytes = [1, 2, 3, 255];
        let image = GreyImage { samples: vec![1, 2, 3, 255], ..image };
        assert_eq!(GreyImage::of(&encoded(png::ColorType::Grayscale, png::BitDepth::Eight, &bytes)).unwrap(), image);
        assert_eq!(GreyImage::of(&[b"P5 2 2 255\n".as_slice(), &bytes].concat()).unwrap(), image);
        // Twelve bits in sixteen are not stretched.
        let pgm = [b"P5 2 2 4095\n".as_slice(), &words].concat();
        assert_eq!(GreyImage::of(&pgm).unwrap().samples[2], 4095);
    }

    #[test]
    fn half_a_file_is_unfinished_and_another_kind_is_refused() {
        let png = encoded(png::ColorType::Grayscale, png::BitDepth::Sixteen, &[7; 8]);
        let pgm = [b"P5 2 2 4095\n".as_slice(), &[7; 8]].concat();
        for whole in [png, pgm] {
            for length in 0..whole.len() - 13 {
                let part = GreyImage::of(&whole[..length]);
                assert!(matches!(part, Err(GreyError::Unfinished(_))), "{length}: {part:?}");
            }
        }
        let colours = encoded(png::ColorType::Rgb, png::BitDepth::Eight, &[7; 12]);
        for other in
            [colours.as_slice(), b"\xFF\xD8\xFF", b"P5 2 2 0\n1234", b"P5 a 2 255\n1234", b"P5 2 2 99999\n12345678"]
        {
            let error = GreyImage::of(other).unwrap_err();
            assert!(error.to_string().contains("dcraw"), "{error}");
        }
    }
}
