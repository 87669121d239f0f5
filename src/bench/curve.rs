//! The cost of a frame as a plot.
//!
//! Must not know: how it was measured.

/// The cost of a frame as a function of one setting.
#[derive(Clone, Debug)]
pub struct Curve {
    /// The setting, with its unit.
    pub axis: &'static str,
    /// Value of the setting and median milliseconds of a frame.
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    /// The curve as an SVG plot.
    #[must_use]
    pub fn to_svg(&self) -> String {
        const SIZE: [f64; 2] = [560.0, 320.0];
        const MARGIN: f64 = 48.0;
        let max = |of: fn(&(f64, f64)) -> f64| self.points.iter().map(of).fold(0.0, f64::max).max(1e-9);
        let (max_x, max_y) = (max(|point| point.0), 1.1 * max(|point| point.1));
        let to_svg = |&(x, y): &(f64, f64)| {
            (
                MARGIN + (SIZE[0] - 2.0 * MARGIN) * x / max_x,
                SIZE[1] - MARGIN - (SIZE[1] - 2.0 * MARGIN) * y / max_y,
            )
        };
        let line: String = self.points.iter().map(to_svg).map(|(x, y)| format!("{x:.1},{y:.1} ")).collect();
        let marks: String = self
            .points
            .iter()
            .map(|point| {
                let ((x, y), (value, ms)) = (to_svg(point), point);
                let base = SIZE[1] - MARGIN + 16.0;
                format!(
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\" fill=\"#44628c\"/>\
                     <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{ms:.1}</text>\
                     <text x=\"{x:.1}\" y=\"{base}\" text-anchor=\"middle\">{value}</text>\n",
                    y - 9.0
                )
            })
            .collect();
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0}\" height=\"{1}\" viewBox=\"0 0 {0} {1}\" \
             font-family=\"sans-serif\" font-size=\"11\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
             <polyline points=\"{line}\" fill=\"none\" stroke=\"#44628c\" stroke-width=\"2\"/>\n{marks}\
             <path d=\"M{MARGIN} {MARGIN}V{2}H{3}\" fill=\"none\" stroke=\"black\"/>\n\
             <text x=\"{4}\" y=\"{5}\" text-anchor=\"middle\">{6}</text>\n<text x=\"8\" y=\"24\">median ms per frame</text>\n</svg>\n",
            SIZE[0],
            SIZE[1],
            SIZE[1] - MARGIN,
            SIZE[0] - MARGIN,
            0.5 * SIZE[0],
            SIZE[1] - 12.0,
            self.axis
        )
    }
}
