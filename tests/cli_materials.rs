//! Damaged files of materials: refused by every command that reads them, with the place and the remedy.

mod desk;

use std::fs;

use tempfile::TempDir;

use desk::{desk, edit, json, refused, zonal};

/// A field of a tensor file.
struct Field {
    name: &'static str,
    dtype: u8,
    shape: Vec<u64>,
    data: Vec<u8>,
}

fn floats(name: &'static str, shape: &[u64], value: impl Fn(u64) -> f32) -> Field {
    let data = (0..shape.iter().product()).flat_map(|i| value(i).to_le_bytes()).collect();
    Field { name, dtype: 10, shape: shape.to_vec(), data }
}

fn letters(name: &'static str, data: &[u8]) -> Field {
    Field { name, dtype: 1, shape: vec![data.len() as u64], data: data.to_vec() }
}

/// The smallest RGL material: two polar angles, tables of 2 x 2.
fn material_fields() -> Vec<Field> {
    vec![
        letters("description", b"test"),
        letters("jacobian", &[0]),
        floats("phi_i", &[1], |_| 0.0),
        floats("theta_i", &[2], |i| i as f32),
        floats("ndf", &[2, 2], |_| 1.0),
        floats("sigma", &[2, 2], |_| 1.0),
        floats("vndf", &[1, 2, 2, 2], |_| 1.0),
        floats("rgb", &[1, 2, 3, 2, 2], |_| 0.2),
    ]
}

fn tensor_file(fields: &[Field]) -> Vec<u8> {
    let mut bytes = b"tensor_file\0\x01\0".to_vec();
    bytes.extend((fields.len() as u32).to_le_bytes());
    let header: usize = fields.iter().map(|f| 13 + f.name.len() + 8 * f.shape.len()).sum();
    let mut offset = (bytes.len() + header) as u64;
    for field in fields {
        bytes.extend((field.name.len() as u16).to_le_bytes());
        bytes.extend(field.name.as_bytes());
        bytes.extend((field.shape.len() as u16).to_le_bytes());
        bytes.push(field.dtype);
        bytes.extend(offset.to_le_bytes());
        field.shape.iter().for_each(|n| bytes.extend(n.to_le_bytes()));
        offset += field.data.len() as u64;
    }
    fields.iter().for_each(|f| bytes.extend(&f.data));
    bytes
}

/// `render` and `measure` refuse the material and name the place.
fn refused_material(desk: &TempDir, material: &str, words: &[&str]) {
    for command in ["render MATERIAL --out old.png", "measure rig.toml plan.toml --out new --simulate MATERIAL"] {
        let words: Vec<&str> = [material].into_iter().chain(words.iter().copied()).collect();
        refused(desk, &command.replace("MATERIAL", material), &words);
    }
}

#[test]
fn damaged_tensor_files_are_refused() {
    let desk = desk();
    let path = desk.path().join("bad.bsdf");
    let whole = tensor_file(&material_fields());
    fs::write(&path, &whole).unwrap();
    json(&zonal(desk.path(), "render bad.bsdf --out new.png --size 8 --json"));

    let changed = |name: &str, change: &dyn Fn(&mut Field)| {
        let mut fields = material_fields();
        change(fields.iter_mut().find(|f| f.name == name).unwrap());
        tensor_file(&fields)
    };
    let many = [&whole[..14], &u32::MAX.to_le_bytes(), &whole[18..]].concat();
    let cases: [(Vec<u8>, &[&str]); 9] = [
        (vec![], &["byte 0", "get it again"]),
        (whole[..16].to_vec(), &["byte 14", "get it again"]),
        (whole[..100].to_vec(), &["byte", "get it again"]),
        (whole[..whole.len() - 1].to_vec(), &["field `rgb`", "get it again"]),
        (many, &["byte 14", "4294967295", "get it again"]),
        (changed("rgb", &|f| f.shape[0] = u64::MAX), &["field `rgb`", "18446744073709551615", "get it again"]),
        (changed("rgb", &|f| f.shape = vec![1 << 40, 1 << 40, 3, 2, 2]), &["field `rgb`", "get it again"]),
        (
            changed("vndf", &|f| f.data[4..8].copy_from_slice(&f32::NAN.to_le_bytes())),
            &["`vndf`", "byte", "NaN", "again"],
        ),
        (changed("theta_i", &|f| f.data.reverse()), &["field `theta_i`", "ascending", "get it again"]),
    ];
    for (bytes, words) in cases {
        fs::write(&path, bytes).unwrap();
        refused_material(&desk, "bad.bsdf", words);
    }
    refused_material(&desk, "missing.bsdf", &["check that it exists"]);
}

#[test]
fn damaged_tables_are_refused() {
    const LENGTH: u64 = 12 + 3 * 90 * 90 * 180 * 8;
    let desk = desk();
    let path = desk.path().join("bad.binary");
    // All but the header are zeros that take no room on the disk.
    let table = |cells: [i32; 3], length: u64| {
        let bytes: Vec<u8> = cells.iter().flat_map(|n| n.to_le_bytes()).collect();
        fs::write(&path, &bytes[..bytes.len().min(length as usize)]).unwrap();
        fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(length).unwrap();
    };
    let cells = [90, 90, 180];
    for (cells, length, words) in [
        (cells, 0, &["byte 0", "get it again"][..]),
        (cells, 11, &["byte 0", "11 bytes", "get it again"]),
        (cells, LENGTH - 1, &["byte 12", "34991999", "get it again"]),
        ([i32::MAX; 3], 100, &["[2147483647, 2147483647, 2147483647]", "get it again"]),
        ([-1; 3], 100, &["[-1, -1, -1]", "get it again"]),
    ] {
        table(cells, length);
        refused_material(&desk, "bad.binary", words);
    }
    table(cells, LENGTH);
    edit(&path, |bytes| bytes[92..100].copy_from_slice(&f64::NAN.to_le_bytes()));
    refused_material(&desk, "bad.binary", &["byte 92", "a finite number", "NaN", "get it again"]);
    refused_material(&desk, "missing.binary", &["check that it exists"]);
}
