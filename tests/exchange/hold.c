/* Holds the newest GNSS fix that has arrived: position and velocity, 10 times a second. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int main(int argc, char **argv) {
    char path[4096], line[8192];
    if (argc != 3) return fprintf(stderr, "usage: hold SENSORS SOLUTION\n"), 2;
    snprintf(path, sizeof path, "%s/gnss.csv", argv[1]);
    FILE *gnss = fopen(path, "r");
    snprintf(path, sizeof path, "%s/output.csv", argv[1]);
    FILE *wanted = fopen(path, "r"), *out = fopen(argv[2], "w");
    if (!gnss || !wanted || !out) return perror(path), 3;
    fgets(line, sizeof line, gnss);
    fgets(line, sizeof line, wanted);
    fprintf(out, "t_s,lat_rad,lon_rad,alt_m,vel_n_mps,vel_e_mps,vel_d_mps\n");
    double t, next[9], held[9];
    int have = 0, more = 0, rows = 0;
    for (; fgets(line, sizeof line, wanted); ) {
        t = atof(line);
        for (;;) {
            if (!more) {
                char text[8192];
                if (!fgets(text, sizeof text, gnss)) break;
                char *cell = strtok(text, ",");
                for (int k = 0; k < 9 && cell; k++, cell = strtok(NULL, ",")) next[k] = atof(cell);
                more = 1;
            }
            if (next[1] > t + 1e-9) break;
            if (next[2] != 0) memcpy(held, next, sizeof held), have = 1;
            more = 0;
        }
        if (have)
            fprintf(out, "%.9f,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g\n", t, held[3], held[4], held[5],
                    held[6], held[7], held[8]), rows++;
    }
    fprintf(stderr, "%d rows\n", rows);
    return fclose(out) ? 4 : 0;
}
